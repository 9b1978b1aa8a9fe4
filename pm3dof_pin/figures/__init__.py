"""Pictures of maps and workspaces, drawn by matplotlib without a window."""
