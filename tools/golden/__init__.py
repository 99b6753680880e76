"""Golden numbers: what the package answers, frozen, to be compared after the code was rearranged.

`python -m tools.golden write FILE` runs every case and writes its numbers; `python -m tools.golden check` runs them
again and lists every number that is another one. `cases` says what is run, `adapter` how the package is asked for it.
After a rearrangement `adapter` is edited until `check` finds nothing; `cases` and golden.json stay as they are.

The numbers belong to the machine and the versions they were written with: another processor's linear algebra rounds
differently, and searches carry that further than the tolerance. On another machine, write them from the old code first.

What is known to carry another rounding further than the tolerance (`cases.LOOSENED`) is listed, and does not fail.
"""
