"""Says at the end which peers were met, and in which version."""

from __future__ import annotations

import pytest

from tests.peers.peers import MET


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line a peer."""
    if MET:
        terminalreporter.section("peers")
    for name, version in sorted(MET.items()):
        terminalreporter.write_line(f"{name} {version}")
