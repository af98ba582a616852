"""Measurements of what the paper says, with its figures beside ours."""
