"""Sign-in by keys: what is kept of them, who is let in, and that nobody else is."""

from __future__ import annotations

import hmac
import json
from dataclasses import replace
from pathlib import Path

import pytest

from cellctl.api.auth import Principal, Role
from cellctl.api.keys import KeyAuth, add_key, hash_of, load_keys, remove_key
from cellctl.app import _warm
from hal.errors import ConfigError
from tests.api.harness import TOKEN, Api, run_api


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "keys.json"


def test_a_key_is_random_and_only_its_hash_is_kept_for_its_owner_only(file: Path) -> None:
    keys = [add_key(file, name, Role.MES) for name in ("mes-1", "mes-2")]
    assert len(set(keys)) == 2
    assert all(len(key) >= 43 for key in keys), "256 bits"
    text = file.read_text(encoding="utf-8")
    assert not any(key in text for key in keys)
    assert [key.sha256 for key in load_keys(file)] == [hash_of(key) for key in keys]
    assert file.stat().st_mode & 0o777 == 0o600


def test_a_key_is_its_holders_and_what_is_kept_of_it_opens_nothing(file: Path) -> None:
    mes, person = add_key(file, "mes-1", Role.MES), add_key(file, "A.Smith", Role.OPERATOR)
    auth = KeyAuth(file)
    assert auth.principal(mes) == Principal("mes-1", Role.MES)
    assert auth.principal(person) == Principal("A.Smith", Role.OPERATOR)
    for other in ("", "mes-1", mes[:-1], f"{mes} ", hash_of(mes), f"admin.{mes}", "\ud800"):
        assert auth.principal(other) is None, other


def test_every_key_is_compared_every_time(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [add_key(file, f"mes-{number}", Role.MES) for number in range(4)]
    auth, compared = KeyAuth(file), []
    whole = hmac.compare_digest

    def counted(kept: str, told: str) -> bool:
        compared.append(kept)
        return whole(kept, told)

    monkeypatch.setattr(hmac, "compare_digest", counted)
    for token in (keys[0], keys[3], "none"):
        compared.clear()
        auth.principal(token)
        assert len(compared) == 4


def test_who_is_removed_is_let_in_no_more_and_who_is_added_at_once(file: Path) -> None:
    first = add_key(file, "mes-1", Role.MES)
    auth = KeyAuth(file)
    second = add_key(file, "mes-2", Role.VIEWER)
    assert auth.principal(second) == Principal("mes-2", Role.VIEWER)
    remove_key(file, "mes-1")
    assert auth.principal(first) is None
    with pytest.raises(ConfigError, match="mes-1 has no key"):
        remove_key(file, "mes-1")


@pytest.mark.parametrize("spoil", ["broken", "open to others", "gone"])
def test_a_file_that_is_spoilt_lets_nobody_in(file: Path, spoil: str, caplog: pytest.LogCaptureFixture) -> None:
    key = add_key(file, "mes-1", Role.MES)
    auth = KeyAuth(file)
    assert auth.principal(key) is not None
    if spoil == "broken":
        file.write_text("{", encoding="utf-8")
    elif spoil == "gone":
        file.unlink()
    else:
        file.chmod(0o640)
    assert auth.principal(key) is None
    assert "nobody is let in" in caplog.text
    with pytest.raises(ConfigError):
        KeyAuth(file)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"role": "king"}, "Input should be"),
        ({"sha256": "A" * 64}, "pattern"),
        ({"name": "a b"}, "pattern"),
        ({"key": "plain"}, "not permitted"),
    ],
)
def test_what_is_no_entry_is_told_at_its_place(file: Path, change: dict[str, str], said: str) -> None:
    entry = {"name": "mes-1", "role": "mes", "sha256": "0" * 64}
    file.touch(0o600)
    file.write_text(json.dumps({"keys": [entry, entry | {"name": "mes-2"} | change]}), encoding="utf-8")
    with pytest.raises(ConfigError, match=said) as error:
        load_keys(file)
    assert error.value.place.startswith("keys.json.keys.1.")


def test_a_name_has_one_key(file: Path) -> None:
    add_key(file, "mes-1", Role.MES)
    with pytest.raises(ConfigError, match="mes-1 has a key already"):
        add_key(file, "mes-1", Role.ADMIN)
    twice = json.loads(file.read_text(encoding="utf-8"))
    twice["keys"] *= 2
    file.write_text(json.dumps(twice), encoding="utf-8")
    with pytest.raises(ConfigError, match="two keys have the name mes-1"):
        load_keys(file)


def test_routes_know_keys_and_their_roles(tmp_path: Path, file: Path) -> None:
    viewer, mes = add_key(file, "screen", Role.VIEWER), add_key(file, "mes-1", Role.MES)

    async def body(api: Api) -> None:
        await _warm(api.app)
        services = replace(api.services, auth=KeyAuth(file))
        api.app.state.services = services
        await _warm(api.app)
        assert api.app.state.services is services, "what was let in for the warming is let in no more"
        codes = []
        for key in (viewer, mes, TOKEN, f"mes.{TOKEN}"):
            api.client.headers["Authorization"] = f"Bearer {key}"
            asked = await api.client.post("/api/v1/cell/commands", json={"command": "stop"})
            codes.append(((await api.client.get("/api/v1/cell")).status_code, asked.status_code))
        assert codes == [(200, 403), (200, 409), (401, 401), (401, 401)]

    run_api(tmp_path, body)
