"""Which liberties compiled kernels may take with floating point."""

FASTMATH = {"nnan", "ninf", "nsz", "contract"}
"""Without reassociation: what it does depends on how code is inlined, so that a kernel just
compiled and one from the cache would differ in the last bit: one seed would give two flights."""
