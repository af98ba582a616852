"""The commands of the ``rtin`` program, and what they share."""
