"""All faults of a file at once: each with its track, and with the rows that have it."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

_SHOWN_ROWS = 5


class FaultLog:
    """Collects faults; a reason that many rows share is one fault that names the first of them."""

    def __init__(self) -> None:
        self._faults: dict[tuple[str, str], list[str]] = {}
        self._counts: dict[tuple[str, str], int] = {}

    def __len__(self) -> int:
        return len(self._faults)

    def add(self, track: str, message: str) -> None:
        """Note a fault, once however often it is found.

        Args:
            track: its name, or "the file".
            message: what is wrong.
        """
        self._faults.setdefault((track, message), [])

    def add_rows(
        self,
        track: str,
        reason: str,
        first_row: int,
        flags: npt.NDArray[np.bool_],
        describe: Callable[[int], str] | None = None,
    ) -> None:
        """Note a fault that some rows of a block have in common.

        Args:
            track: that the rows are of, or "the file".
            reason: what is wrong with each of them.
            first_row: the number in the file of the block's first row.
            flags: (b,) which rows of the block have the fault; where none has, nothing is noted.
            describe: from a row's number in the block to more about it, which stands behind its number in the file.
        """
        flagged = np.flatnonzero(flags)
        if not len(flagged):
            return
        rows = self._faults.setdefault((track, reason), [])
        self._counts[track, reason] = self._counts.get((track, reason), 0) + len(flagged)
        for row in flagged[: max(0, _SHOWN_ROWS - len(rows))]:
            rows.append(f"{first_row + row}" + (f" ({describe(int(row))})" if describe else ""))

    def lines(self) -> list[str]:
        """Return one line per fault, in the order in which they were found."""
        return [
            f"{track}: {reason}{self._where(track, reason, rows)}" for (track, reason), rows in self._faults.items()
        ]

    def _where(self, track: str, reason: str, rows: list[str]) -> str:
        if not rows:
            return ""
        count = self._counts[track, reason]
        more = f" and {count - len(rows)} more" if count > len(rows) else ""
        return f": row {rows[0]}" if count == 1 else f": rows {', '.join(rows)}{more}"
