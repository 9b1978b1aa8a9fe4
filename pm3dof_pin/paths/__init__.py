"""Tool paths: read from tables or G-code, judged before they are run, and placed in the workspace."""
