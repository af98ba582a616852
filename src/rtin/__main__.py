"""``python -m rtin`` is the ``rtin`` program."""

from rtin.cli import main

main()
