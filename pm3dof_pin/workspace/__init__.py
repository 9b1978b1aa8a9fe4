"""The reachable set of the tripod under all its joint limits: sections, boundary, area, volume (Fig. 8.2)."""

from pm3dof_pin.workspace.section import WorkspaceSection, workspace_section
from pm3dof_pin.workspace.stack import Workspace, height_range, workspace

__all__ = ["Workspace", "WorkspaceSection", "height_range", "workspace", "workspace_section"]
