"""Robot description files: finding them, and reading them into typed, checked data."""
