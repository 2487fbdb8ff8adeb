"""How many commands one sender may give: the first COMMANDS_PER_S of every second. The e-stop does not count."""

from typing import Final, NamedTuple

COMMANDS_PER_S: Final = 50  # a person's finger makes ten; the controller takes one per cycle
WINDOW_NS: Final = 1_000_000_000


class Sender(NamedTuple):
    """Who asks. `proven`: by a certificate; otherwise `name` is what the sender says, "" for nothing."""

    name: str
    proven: bool

    def __str__(self) -> str:
        if self.proven:
            return self.name
        return f"{self.name} (as stated)" if self.name else "somebody on this machine"


class RateLimit:
    """Counts commands by sender in windows of one second. Memory: one entry per certificate, one for all others."""

    def __init__(self) -> None:
        self._windows: dict[str, tuple[int, int]] = {}

    def count(self, sender: Sender, now_ns: int) -> int:
        """How many commands this one makes in its sender's window; 1 for the first."""
        # Who proves nothing could take a new name for every command.
        key = sender.name if sender.proven else ""
        start, counted = self._windows.get(key, (now_ns, 0))
        if now_ns - start >= WINDOW_NS:
            start, counted = now_ns, 0
        self._windows[key] = (start, counted + 1)
        return counted + 1
