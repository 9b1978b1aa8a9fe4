"""Pictures of maps and of the workspace, drawn by matplotlib without a window."""
