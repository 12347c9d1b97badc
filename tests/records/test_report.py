from html.parser import HTMLParser

import numpy as np

from cellctl.records.report import report_of
from hal.clock import run_virtual
from tests.records.test_summary import whole_run
from tests.records.world import desk, header, small_run


class Page(HTMLParser):
    """Tags and their attributes, and whether every tag is closed in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs


def curve(digest: str) -> dict[str, np.ndarray]:
    return {"z_mm": np.linspace(365.0, 396.0, 50), "force_n": np.linspace(0.0, 4.0, 50)}


def test_a_whole_run_as_a_page_that_loads_nothing() -> None:
    text = report_of(whole_run(), curve)
    page = Page(text)
    assert page.open == []
    assert page.tags.count("svg") == 2
    assert not {"script", "link", "img", "iframe"} & set(page.tags)
    assert not [value for name, value in page.attributes if name in ("src", "href") or name.startswith("on")]
    for said in (
        "accepted",
        "Complete",
        "S&lt;1&gt;",
        "gun &lt;a&gt;",
        "simulated",
        "covariance_a",
        "limit 10",
        "spigot_1_c",
    ):
        assert said in text
    assert whole_run()[-1].hash in text


def test_the_same_rows_give_the_same_page() -> None:
    assert report_of(whole_run(), curve) == report_of(whole_run(), curve)


def test_reasons_are_told() -> None:
    async def main() -> str:
        at = await desk()
        await at.ledger.note("run", header())
        await small_run(at.ledger, verdict="rejected")
        rows = await at.journal.rows()
        await at.close()
        return report_of(rows)

    text = run_virtual(main())
    assert "rejected" in text
    assert "gap &gt; 0.05 mm" in text


def test_an_empty_journal_has_a_page_too() -> None:
    assert "no verdict" in report_of(())
