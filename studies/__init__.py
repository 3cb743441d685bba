"""Studies: one script, one question, one chart and one CSV each. Run as `python -m studies.NAME`."""
