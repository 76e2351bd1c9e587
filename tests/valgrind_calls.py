"""Every call of tests/leaks.py, twice: what tests/valgrind.sh looks at."""

from __future__ import annotations

import leaks

for call in leaks.CALLS.values():
    call()
    call()
print(f"{len(leaks.CALLS)} calls")
