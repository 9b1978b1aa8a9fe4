"""The viewer: a mechanism in a browser, with ellipsoids, forces and workspace."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, require_choice, require_kind
from pm3dof_pin.elastic.indices import OtherMotions
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError, SingularConfigurationError
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularity_distances
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import MOTIONS, Array, Motion, Vector
from pm3dof_pin.viewer import animation, arrows, colours, ellipsoids, objects, shell
from pm3dof_pin.viewer.bodies import Bodies, DrawnBody, role_of
from pm3dof_pin.viewer.ellipsoids import (
    EXPLANATIONS,
    UNITS,
    DrawnEllipsoid,
    EllipsoidMatrix,
    EllipsoidQuantity,
    MotionQuantity,
)
from pm3dof_pin.viewer.labels import display_title, label, measures, point_names
from pm3dof_pin.viewer.lacks import immobile, lacks_of
from pm3dof_pin.viewer.mirror import mirror
from pm3dof_pin.viewer.page_programs import declared_errors, programs_of
from pm3dof_pin.viewer.panel import Entry, numbers_with_unit, scale_text
from pm3dof_pin.viewer.plane import MotionSpace
from pm3dof_pin.viewer.polytopes import COLOURS as POLYTOPE_COLOURS
from pm3dof_pin.viewer.polytopes import TITLES, DrawnPolytope, PolytopeQuantity, draw_polytope, tool_polytope
from pm3dof_pin.viewer.scene import Json
from pm3dof_pin.viewer.showing import ShownScene
from pm3dof_pin.viewer.sliders import LONG_READING, Sliders, reading, sets_of
from pm3dof_pin.viewer.still import still_picture
from pm3dof_pin.viewer.surroundings import draw_surroundings

if TYPE_CHECKING:
    from pm3dof_pin.capability.transmission import Limit
    from pm3dof_pin.elastic.elastic_model import ElasticModel
    from pm3dof_pin.errors.error_parameters import GeometricErrors


_CLOSED = 1e-6  # largest closure error of a configuration whose forces can be compared [m, rad]
_NEAR = 1.2  # closeness of the camera: the corners of a machine's bounding box are mostly empty
_ENLARGED = 0.15  # greatest deflection that is drawn beside a path [half diagonals of the box]
_BULK = 3.0  # ellipsoids of a smaller axis ratio are drawn smaller, so as to hide less
_GHOST_COLOUR = (0.165, 0.322, 1.0)  # of swinging ghosts, in free_motion.js
_SWING = 0.08  # greatest drawn motion of a mode, in sizes of the machine
_ROOM = (1.15, -1.15)  # extent of an ellipsoid's axes with the numbers at their ends [semi-axes]


class Viewer(ShownScene):
    """A mechanism in a browser.

    Nothing is served and no browser is needed until requested: :meth:`start`, :meth:`open` and :meth:`jupyter_cell`
    serve the scene, :meth:`html` and :meth:`save_html` write it into one file, :meth:`save_picture` takes a picture.

    Ellipsoids, forces and leg colours belong to the configuration displayed when they are drawn; displaying another one
    removes them.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("hexapod")
        >>> with pm.Viewer(model.rigid) as viewer:
        ...     viewer.display(model.rigid.home)
        ...     ellipsoid = viewer.stiffness_ellipsoid(pm.cartesian_compliance(model, model.rigid.home).stiffness)
        ...     page = viewer.save_html("hexapod.html")

    Args:
        mechanism: the mechanism to show.
        sliders: whether the page has sliders for the robot's coordinates and commands, which move it with closed loops
            and update items drawn for its own springs and weight. A robot without programs has none; this is logged.
        model: the mechanism with the springs that sliders use; by default those of its description.
        visuals: Pinocchio's visual geometry, or the path of a URDF that has it; by default the URDF next to the
            mechanism's closures file. If there is none, a stick figure is drawn.
        viewer: a `meshcat.Visualizer`, or a path in one such as `visualizer["left"]`, into which the robot is also
            drawn; so several robots share a scene, that of another viewer by `meshcat.Visualizer(window=other.scene)`.
        open: whether to open the page in a browser at once, as :meth:`open` does.
        host: interface to listen on; by default only this machine.
        port: port to listen on; by default the first free one from 7000.

    Attributes:
        mechanism: the mechanism shown.
        scene: the tree of drawn objects; `meshcat.Visualizer(window=viewer.scene)` draws more into it.

    Raises:
        DescriptionError: the URDF is unreadable, or one of its meshes is missing.
        InvalidValueError: the elastic model is not one of the mechanism.
    """

    def __init__(
        self,
        mechanism: Robot,
        *,
        sliders: bool = True,
        model: ElasticModel | None = None,
        visuals: pin.GeometryModel | Path | str | None = None,
        viewer: Any = None,
        open: bool = False,
        host: str = "127.0.0.1",
        port: int | None = None,
    ) -> None:
        require_kind("mechanism", mechanism, Robot, "pm.load")
        super().__init__(display_title(mechanism), host, port)
        if model is not None and not mechanism.matches(model.rigid):
            raise InvalidValueError("model", model, f"an elastic model of {mechanism}")
        self.mechanism = mechanism
        self._bodies = Bodies.from_mechanism(mechanism, visuals)
        self._box = self._bodies.box(mechanism.home)
        self._radius = max(1e-3, 0.5 * float(np.linalg.norm(self._box[1] - self._box[0])))
        self._unit_length = ellipsoids.round_length(0.42 * self._radius)  # of semi-axes and arrows, rounded
        self._programs = programs_of(mechanism, model) if sliders else None
        self._sliders = Sliders(mechanism, self._programs) if self._programs is not None else None
        self._sets = sets_of(mechanism)
        self._scales: dict[tuple[str, ...], float] = {}
        self._is_recording = False  # frames of a path are not updated by sliders
        self._draw_bodies()
        self._space = MotionSpace.from_configuration(mechanism.home)
        self._direction: tuple[float, float, float | None] = (*self._space.camera, None)
        self._immobile = immobile(mechanism)
        lacks = lacks_of(mechanism, None if model is None else model.springs)
        if sliders and self._programs is None:
            lacks.append(f"no sliders: {mechanism.reason_without_programs() or 'there is no program'}")
        self._panel |= {"robot": mechanism.name, "roles": self._roles(), "lacks": lacks}
        self._panel["immobile"] = self._immobile
        if self._sliders is not None:
            self._panel["machine"] = self._sliders.machine_data(self._bodies)
        self._configuration = mechanism.home
        self.display(mechanism.home)
        self.init_viewer(viewer, open=open)

    def init_viewer(self, viewer: Any = None, open: bool = False, loadModel: bool = False) -> None:
        """Draw the robot into a `meshcat.Visualizer` too, and open the page, as Pinocchio's `initViewer` does.

        The robot's model is always loaded.
        """
        if viewer is not None:
            mirror(self.scene, viewer)
        if open:
            self.open()

    initViewer = init_viewer  # noqa: N815
    """As Pinocchio's MeshcatVisualizer calls it."""

    def load_viewer_model(self) -> None:
        """Show the robot at home, as after Pinocchio's `loadViewerModel`; its bodies are loaded from the start."""
        self.display(self.mechanism.home)

    loadViewerModel = load_viewer_model  # noqa: N815
    """As Pinocchio's MeshcatVisualizer calls it."""

    @property
    def configuration(self) -> Configuration:
        """The displayed configuration."""
        return self._configuration

    def display(self, configuration: Configuration | Poses | ArrayLike) -> None:
        """Show a configuration; items drawn for another one are removed.

        Args:
            configuration: a configuration of the mechanism, a single solved pose, or q, shape=(nq,) [m, rad].

        Raises:
            InvalidValueError: the configuration is of another mechanism, or is not a q of this one; there are several
                poses, which :meth:`play` shows.
            UnreachablePoseError: the pose is out of reach.
        """
        if isinstance(configuration, Poses):
            if len(configuration) != 1:
                problem = f"has {len(configuration)} poses"
                raise InvalidValueError("configuration", problem=problem, expected="one, or play(poses)")
            configuration = (
                configuration.configuration() if configuration.shape == () else configuration.configuration(0)
            )
        if isinstance(configuration, Configuration):
            if not self.mechanism.matches(configuration.mechanism):
                problem = f"is one of {configuration.mechanism}"
                raise InvalidValueError("configuration", problem=problem, expected=f"one of {self.mechanism}")
            if configuration.mechanism is not self.mechanism:
                configuration = configuration.q
        if not isinstance(configuration, Configuration):
            configuration = self.mechanism.configuration(configuration)
        self._configuration = configuration
        for entry in [entry for entry in self._entries.values() if entry.of_pose]:
            self._remove_entry(entry)
        self._reset_camera()
        self.scene.set_transforms(self._bodies.placements(configuration))
        if self._panel.get("path"):
            self._panel["path"] = None
            self._entries.pop("trace", None)
            self.scene.stop_animation()
        self._panel["note"], self._panel["warnings"] = self._note(configuration)
        self._panel["q"] = configuration.q.tolist()
        self._update()

    def stiffness_ellipsoid(
        self,
        stiffness: ArrayLike | None = None,
        *,
        compliance: ArrayLike | None = None,
        at: str | ArrayLike | None = None,
        kind: Motion = "translation",
        of: EllipsoidMatrix = "stiffness",
        others: OtherMotions | None = None,
        scale: float | None = None,
    ) -> DrawnEllipsoid:
        """Draw a stiffness or compliance ellipsoid: principal directions as axes, principal values as semi-axes.

        Args:
            stiffness: K at the point, world axes, shape=(6, 6) [N/m, N, N m/rad].
            compliance: C instead of K, shape=(6, 6).
            at: frame or point, shape=(3,) [m], of K; the tool by default.
            kind: translations or rotations.
            of: draw a stiffness or a compliance.
            others: whether the other three motions are free or held, see :func:`pm3dof_pin.viewer.ellipsoids.block`; by
                default held for a stiffness and free for a compliance, which shows a block of K or C itself.
            scale: length of a semi-axis for a value of 1 [m per unit]; by default a round one that suits the first
                ellipsoid of its kind, and is kept, so that ellipsoids can be compared.

        Returns:
            The drawn ellipsoid.

        Raises:
            InvalidValueError: neither or both of K and C are given, the matrix is not finite, or the scale is not
                positive.
            SingularConfigurationError: the ellipsoid does not exist, since some motion is free or rigid.
            FrameNotFoundError: the model has no such frame.
            DescriptionError: no frame is given, and the mechanism has no tool frame.
        """
        others = others or ("held" if of == "stiffness" else "free")  # shows a block of K or C itself
        block = ellipsoids.block(stiffness, compliance, kind, of, others, self._space)
        rest = "rotations" if kind == "translation" else "translations"
        return self._draw_ellipsoid(block, kind, of, others, scale=scale, at=at, explanation=f"{rest} {others}")

    def motion_ellipsoid(
        self,
        of: MotionQuantity = "velocity",
        *,
        kind: Motion = "translation",
        errors: GeometricErrors | None = None,
        scale: float | None = None,
    ) -> DrawnEllipsoid:
        """Draw an ellipsoid of the tool's velocities, forces or errors in the displayed configuration.

        Args:
            of: "velocity" of the tool for command rates of unit norm, "force" for actuator forces of unit norm, or
                "error", the standard deviation of the tool's pose.
            kind: translations or rotations.
            errors: the parameters whose tolerances cause the error; by default those of the robot's error file.
            scale: see :meth:`stiffness_ellipsoid`.

        Returns:
            The drawn ellipsoid.

        Raises:
            InvalidValueError: there is no such quantity, the scale is not positive, or the loops cannot close with an
                error.
            SingularConfigurationError: the tool can move with all actuators at rest, or, for a force ellipsoid, it does
                not move in some direction.
            DescriptionError: there is no tool frame; or neither errors nor an error file are given.
        """
        from pm3dof_pin.errors.error_parameters import GeometricErrors
        from pm3dof_pin.errors.sensitivity import sensitivities

        robot = self.mechanism
        if of not in EXPLANATIONS:
            raise InvalidValueError("of", of, f"one of {', '.join(EXPLANATIONS)}")
        parameters = GeometricErrors(robot, [])
        if of == "error":
            parameters = errors if errors is not None else declared_errors(robot)
        motions = sensitivities(parameters, robot.at([self._configuration.q]))
        matrix = motions.errors[0] * parameters.tolerances if of == "error" else motions.commands[0]
        block = ellipsoids.motion_block(matrix, kind, of)
        is_own = errors is None
        return self._draw_ellipsoid(block, kind, of, "free", scale=scale, explanation=EXPLANATIONS[of], is_own=is_own)

    def capability_polytope(
        self,
        of: PolytopeQuantity = "force",
        *,
        kind: Motion = "translation",
        effort: Limit = None,
        speed: Limit = None,
        scale: float | None = None,
        visible: bool = True,
    ) -> DrawnPolytope:
        """Draw what the limits of the drives permit at the tool in the displayed configuration.

        Args:
            of: "force", all forces without a moment that the drives can exert while they hold the weight, or "speed",
                all velocities of the tool's point.
            kind: translations, or rotations: moments without a force, or angular velocities.
            effort: limits of the drives' efforts [N, N m]; the description's by default.
            speed: limits of their speeds [m/s, rad/s]; the description's by default.
            scale: length for a value of 1 [m per unit]; by default a round one that suits the first polytope of its
                kind, and is kept.
            visible: whether it is shown initially.

        Returns:
            The polytope in world axes.

        Raises:
            InvalidValueError: there is no such quantity, a limit is unknown, or the drives cannot hold the weight.
            SingularConfigurationError: the tool does not move in this way, or the drives do not determine its motion.
            DescriptionError: there is no tool frame.
        """
        from pm3dof_pin.capability.tool_capability import tool_capability

        require_choice("of", of, PolytopeQuantity)
        require_choice("kind", kind, Motion)
        at = tool_capability(self.mechanism, self._configuration, effort=effort, speed=speed)
        drawn = tool_polytope(at, of, kind)
        if scale is None:
            scale = self._kept_scale((kind, of, "polytope"), drawn.greatest)
        if not (np.isfinite(scale) and scale > 0.0):
            raise InvalidValueError("scale", scale, "a positive length for one unit")
        live = None
        if sliders := self._live_sliders:
            live = sliders.live_polytope(
                at, self._configuration, of=of, kind=kind, scale=scale, length=self._unit_length
            )
        path, key = f"/polytopes/{of}_{kind}", f"{of}_{kind}_polytope"
        draw_polytope(self.scene, path, drawn, of, scale)
        self.scene.set_transform(path, objects.transform(translation=self._point(None)))
        if visible:
            self._beside[key] = self._point(None) + scale * drawn.vertices
            self._reset_camera()
        self._show(
            Entry(
                key=key,
                title=TITLES[of, kind],
                lines=[
                    scale_text(scale, self._unit_length, drawn.unit, "length"),
                    f"within the drives' {'efforts' if of == 'force' else 'speeds'}, least and greatest",
                ],
                values=numbers_with_unit([drawn.least, drawn.greatest], drawn.unit),
                colour=colours.css(POLYTOPE_COLOURS[of]),
                nodes=[path],
                visible=visible,
                live=live,
            )
        )
        return drawn

    def actuator_forces(
        self, forces: ArrayLike, *, what: str = "Actuator forces", scale: float | None = None
    ) -> dict[str, Array]:
        """Draw arrows at the actuators: forces of prismatic joints, moments (two heads) of revolute ones.

        Args:
            forces: one for each actuated joint, positive along its axis, shape=(number of actuated joints,) [N, N m].
            what: title in the legend.
            scale: length of an arrow for 1 N or 1 N m [m]; by default a round one for the first forces, which is kept.

        Returns:
            The transform of each arrow, by its path in the scene, shape=(4, 4): its third column is the force, scaled.

        Raises:
            InvalidValueError: the forces are not finite or have the wrong shape, or the scale is not positive.
        """
        axes = arrows.ActuatorAxis.from_configuration(self._configuration)
        values = finite_array("forces", forces, (len(axes),))
        if scale is None:
            scale = self._kept_scale(("forces",), np.abs(values).max(initial=0.0))
        if not (np.isfinite(scale) and scale > 0.0):
            raise InvalidValueError("scale", scale, "a positive length for one newton")
        width = 0.016 * self._radius
        drawn: dict[str, Array] = {}
        for axis, value in zip(axes, values, strict=True):
            path = f"/forces/{axis.joint}"
            if f"{path}/shaft" not in self.scene.paths():
                axis.draw(self.scene, path)
            drawn[path] = axis.arrow(value, scale=scale, width=width)
        self.scene.set_transforms(drawn)
        unit, live = ", ".join(sorted({axis.unit for axis in axes})), None
        if sliders := self._live_sliders:
            live = sliders.live_forces(
                values, self._configuration, scale=scale, length=self._unit_length, width=width, unit=unit
            )
        self._show(
            Entry(
                key="forces",
                title=what,
                lines=[scale_text(scale, self._unit_length, unit, "arrow")],
                values=numbers_with_unit(values, [axis.unit for axis in axes]),
                colour=colours.css(arrows.COLOUR),
                nodes=list(drawn),
                live=live,
            )
        )
        return drawn

    def colour_legs(
        self,
        model: ElasticModel,
        wrench: ArrayLike = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        *,
        visible: bool = True,
    ) -> dict[str, float]:
        """Colour the legs by their share in the deflection of the tool under a load.

        Args:
            model: the mechanism with its springs.
            wrench: the load [f; m] at the tool, world axes, shape=(6,) [N, N m]; a vertical force by default.
            visible: whether the legs are coloured initially.

        Returns:
            Share of each spring, by name.

        Raises:
            InvalidValueError: the elastic model is not one of the mechanism, or the wrench is zero or not finite.
            SingularConfigurationError: no spring deflects under the load.
            PM3DofError: there is no compliance, as for :func:`~pm3dof_pin.elastic.report.cartesian_compliance`.
        """
        from pm3dof_pin.elastic.report import cartesian_compliance
        from pm3dof_pin.elastic.shares import shares
        from pm3dof_pin.viewer.legs import ColouredLegs

        if not self.mechanism.matches(model.rigid):
            raise InvalidValueError("model", model, f"an elastic model of {self.mechanism}")
        load = finite_array("wrench", wrench, (6,))
        behaviour = cartesian_compliance(model, self._configuration)
        by_spring = dict(zip(model.spring_names, shares(behaviour.contributions, load).tolist(), strict=True))
        if not np.isfinite(list(by_spring.values())).all():
            raise SingularConfigurationError(f"no spring of {self.mechanism.name} deflects under {_load_text(load)}")
        legs = ColouredLegs(model)
        by_joint = legs.shares(by_spring)
        of_legs = {legs.number(joint): share for joint, share in by_joint.items()}
        names = [", ".join(springs) for springs in legs.springs]
        live = None
        if sliders := self._live_sliders:
            live = sliders.live_shares(legs.springs, self._configuration, behaviour.compliance, load)
        self._show(
            Entry(
                key="legs",
                title="Share in the compliance",
                lines=[f"under {_load_text(load)}"],
                visible=visible,
                values="\n".join(
                    f"{name}: {100.0 * share:.1f} %" for name, share in zip(names, of_legs.values(), strict=True)
                ),
                bar={"colours": list(colours.SHARE_STOPS), "ends": ["0 %", "100 %"]},
                paint=legs.paint(self._bodies, by_joint),
                live=live,
            )
        )
        return by_spring

    def load(
        self, model: ElasticModel, wrench: ArrayLike = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), *, visible: bool = True
    ) -> Array:
        """Draw a load at the tool as arrows, and in the page the tool's body where it takes it, magnified.

        In the page the arrow of the force can be dragged by its tip.

        Args:
            model: the mechanism with its springs.
            wrench: the load [f; m] at the tool, world axes, shape=(6,) [N, N m]; a vertical force by default.
            visible: whether it is shown initially.

        Returns:
            The deflection [v; w] of the tool in world axes, shape=(6,) [m, rad].

        Raises:
            InvalidValueError: the elastic model is not one of the mechanism, or the wrench is zero or not finite.
            PM3DofError: there is no compliance, as for :func:`~pm3dof_pin.elastic.report.cartesian_compliance`.
        """
        from pm3dof_pin.elastic.report import cartesian_compliance

        if not self.mechanism.matches(model.rigid):
            raise InvalidValueError("model", model, f"an elastic model of {self.mechanism}")
        load = finite_array("wrench", wrench, (6,))
        if not load.any():
            raise InvalidValueError("wrench", load, "a load other than zero")
        compliance = cartesian_compliance(model, self._configuration).compliance
        deflection: Array = compliance @ load
        lines, values, sizes = [], [], np.linalg.norm(load.reshape(2, 3), axis=1)
        for name, part, size, unit in zip(("force", "moment"), load.reshape(2, 3), sizes, ("N", "N m"), strict=True):
            path = f"/load/{name}"
            arrows.draw_arrow(self.scene, path, turns=name == "moment", colour=arrows.LOAD_COLOUR)
            scale = self._unit_length if not size else ellipsoids.round_scale(float(size), self._unit_length)
            axis = arrows.ActuatorAxis(name, self._point(None), part / size if size else np.eye(3)[2], False)
            self.scene.set_transform(path, axis.arrow(float(size), scale=scale, width=0.016 * self._radius))
            if size:
                lines.append(scale_text(scale, self._unit_length, unit, "arrow"))
                values.append(numbers_with_unit([size], unit))
        moved = zip(np.linalg.norm(deflection.reshape(2, 3), axis=1), ("m", "rad"), strict=True)
        live = None
        if sliders := self._live_sliders:
            live = sliders.live_load(self._configuration, compliance, load, length=self._unit_length)
        self._show(
            Entry(
                key="load",
                title="Deflection under a load",
                lines=[", ".join(lines), *(["drag the arrow by its tip"] if live else [])],
                values=f"{', '.join(values)}: {', '.join(numbers_with_unit([size], unit) for size, unit in moved)}",
                colour=colours.css(arrows.LOAD_COLOUR),
                nodes=["/load/force", "/load/moment", "/load/ghost"],
                visible=visible,
                live=live,
            )
        )
        return deflection

    def modes(self, model: ElasticModel, count: int = 3, *, visible: bool = True) -> Vector:
        """Let the machine swing in its lowest natural modes, in the page: a ghost, exaggerated and slow.

        Args:
            model: the mechanism with its springs.
            count: number of modes.
            visible: whether the first of them is shown initially.

        Returns:
            Their frequencies, ascending, shape=(count or fewer,) [Hz].

        Raises:
            InvalidValueError: the elastic model is not one of the mechanism.
            PM3DofError: as :func:`~pm3dof_pin.dynamics.modes.natural_modes`.
        """
        from pm3dof_pin.dynamics.modes import natural_modes

        if not self.mechanism.matches(model.rigid):
            raise InvalidValueError("model", model, f"an elastic model of {self.mechanism}")
        found = natural_modes(model, self._configuration, count=count)
        twists = found.body_twists(self.mechanism.model.names)
        for number, (frequency, moved) in enumerate(zip(found.frequencies.tolist(), twists, strict=True), start=1):
            sizes = np.linalg.norm(moved.reshape(-1, 2, 3), axis=2) * [1.0, self._radius]
            swing = _SWING * self._radius / sizes.max(initial=0.0) * moved
            ghost, text = f"/mode{number}", numbers_with_unit([frequency], "Hz", digits=4)
            live: Json = {"kind": "mode", "q": self._configuration.q.tolist(), "twists": swing.tolist(), "values": text}
            self._show(
                Entry(
                    key=f"mode{number}",
                    title=f"Mode {number}",
                    lines=["exaggerated and slow"],
                    values=text,
                    colour=colours.css(_GHOST_COLOUR),
                    nodes=[ghost],
                    visible=visible and number == 1,
                    live=live if self._live_sliders else None,
                )
            )
        return found.frequencies

    def frames(self, names: Iterable[str] | None = None, length: float | None = None) -> None:
        """Draw frames as three arrows: x red, y green, z blue. They move with their bodies.

        Args:
            names: links or frames of the model; by default the tool's and those of the closures.
            length: length of the arrows [m].

        Raises:
            FrameNotFoundError: the model has no such frame.
        """
        closing = [name for loop in self.mechanism.closures for name in (loop.frame_a, loop.frame_b)]
        tool = [self.mechanism.tool_frame] if self.mechanism.tool_frame else []
        size = 0.07 * self._radius if length is None else length
        shown = tuple(dict.fromkeys(tool + closing if names is None else names))
        paths = []
        for name in shown:
            body_path, in_body = self._body_at(name)
            paths.append(f"{body_path}/frames/{name.replace('/', '_')}")
            arrows.draw_frame(self.scene, paths[-1], in_body, size)
        lines = [", ".join(shown), "x red, y green, z blue"]
        self._show(Entry(key="frames", title="Frames", lines=lines, nodes=paths, of_pose=False))

    def display_frames(self, visibility: bool, frame_ids: Iterable[int] | None = None) -> None:
        """Draw :meth:`frames` by their numbers in the Pinocchio model, by default the same ones, or hide them.

        Raises:
            InvalidValueError: the model has no frame of such a number.
        """
        frames, ids = self.mechanism.model.frames, None if frame_ids is None else [int(number) for number in frame_ids]
        for number in ids or ():
            if not 0 <= number < len(frames):
                raise InvalidValueError("frame_ids", number, f"a number from 0 to {len(frames) - 1}")
        if drawn := self._entries.get("frames"):
            self._remove_entry(drawn)
            self._update()
        if visibility:
            self.frames(None if ids is None else [frames[number].name for number in ids])

    displayFrames = display_frames  # noqa: N815
    """As Pinocchio's MeshcatVisualizer calls it."""

    def labels(self) -> None:
        """Label points with their names; for the chapter's machine also the lengths and angles of Fig. 8.1b."""
        height, paths = 0.09 * self._radius, []
        named = [(name, text, None) for name, text in point_names(self._configuration).items()]
        others = [(frame, text, place) for text, (frame, place) in measures(self._configuration).items()]
        for number, (name, text, place) in enumerate([*named, *others]):
            body_path, in_body = self._body_at(name)
            placement = in_body.copy()
            if place is not None:  # in the axes of its frame
                placement = in_body @ self._configuration.frame_placement(name).inverse().homogeneous
                placement[:3, 3] = (placement @ np.append(place, 1.0))[:3]
            else:
                placement[:3, 3] += 0.015 * self._radius
            placement[:3, :3] = np.eye(3)
            paths.append(f"{body_path}/labels/{number}")
            self.scene.set_object(paths[-1], label(text, height, measure=place is not None), casts_shadow=False)
            self.scene.set_transform(paths[-1], placement)
        lines = [f"{len(named)} points", *([f"{len(others)} lengths and angles"] if others else [])]
        self._show(Entry(key="labels", title="Names", lines=lines, nodes=paths, of_pose=False))

    def workspace(
        self,
        quantity: str = "translational_stiffness:least",
        *,
        tool_length: float | None = None,
        cells: int = 29,
    ) -> None:
        """Draw the boundary of the points that the tip of a tool on the platform reaches, coloured by a quantity.

        Args:
            quantity: the quantity, as :func:`pm3dof_pin.viewer.shell.workspace_shell` takes it.
            tool_length: length of the tool along its z axis [m]; by default zero if the first coordinate is a length,
                else a third of the machine's size.
            cells: number of cells of the grid along each coordinate.

        Raises:
            InvalidValueError: there is no such quantity, or the workspace has no such shell.
            DescriptionError: the robot has no tool frame.
        """
        tool = self.mechanism.frame_name()
        length = tool_length
        if length is None:
            is_position = all(coordinate.unit == "m" for coordinate in self.mechanism.coordinates[:2])
            length = 0.0 if is_position else ellipsoids.round_length(0.42 * self._radius)
        surface = shell.workspace_shell(self.mechanism, quantity, tool_length=length, cells=cells)
        surface.draw(self.scene, "/workspace", 0.022 * self._radius)
        self._beside["workspace"] = surface.vertices[::7]
        body_path, in_body = self._body_at(tool)
        shell.draw_tool(self.scene, f"{body_path}/tool", in_body, length, 0.014 * self._radius)
        self._show(surface.entry("/workspace", f"{body_path}/tool", length))
        self._reset_camera()

    def play(
        self,
        configurations: Sequence[Configuration] | Poses,
        *,
        stiffness: Sequence[ArrayLike] | None = None,
        compliance: Sequence[ArrayLike] | None = None,
        forces: Sequence[ArrayLike] | None = None,
        of: EllipsoidMatrix = "stiffness",
        others: OtherMotions | None = None,
        deflections: ArrayLike | None = None,
        duration: float = 5.0,
        repetitions: int = 1,
    ) -> None:
        """Play a path as an animation, with its ellipsoids and forces, and the line of the tool.

        Args:
            configurations: frames of the path, or solved poses, equally spaced in time, at least two.
            stiffness: K at the tool in each frame, shape=(6, 6) each; without K or C no ellipsoids are drawn.
            compliance: C instead of K, shape=(6, 6) each.
            forces: actuator forces in each frame, see :meth:`actuator_forces`.
            of: see :meth:`stiffness_ellipsoid`.
            others: see :meth:`stiffness_ellipsoid`.
            deflections: displacements of the tool point in each frame, base axes, drawn beside the line of the tool,
                enlarged, shape=(frames, 3) [m].
            duration: duration of the whole path [s].
            repetitions: number of times it is played.

        Raises:
            InvalidValueError: there are fewer than two frames, a different number of K or forces, or the duration is
            not positive. ShapeError: the deflections have another shape. SingularConfigurationError: an ellipsoid does
            not exist.
        """
        configurations = list(configurations)
        frames = len(configurations)
        if frames < 2:
            raise InvalidValueError("configurations", problem=f"are {frames}", expected="at least two")
        given: list[Sequence[ArrayLike | None]] = []
        for name, values in (("stiffness", stiffness), ("compliance", compliance), ("forces", forces)):
            if values is not None and len(values) != frames:
                raise InvalidValueError(
                    name, problem=f"has {len(values)} entries", expected=f"one for each of {frames} frames"
                )
            given.append([None] * frames if values is None else values)
        if not (np.isfinite(duration) and duration > 0.0):
            raise InvalidValueError("duration", duration, "a positive time [s]")
        per_frame = list(zip(configurations, given[0], given[1], given[2], strict=True))
        self._is_recording = True
        try:
            recorded = [self._frame_of_path(*given, of, others) for given in per_frame]
        finally:
            self._is_recording = False
        self._frame_of_path(*per_frame[0], of, others)
        tracks = {path: [transforms[path] for transforms, _ in recorded] for path in recorded[0][0]}
        self._panel["path"] = {
            "duration": duration,
            "frames": [said for _, said in recorded],
            "singularity": _distances_to_singularities(configurations),
        }
        self.scene.set_animation(animation.clips(tracks, (frames - 1) / duration), repetitions=repetitions)
        if self._sliders is not None and self.mechanism.tool_frame is not None:
            # drawn by the page
            lines = ["line of the tool, red where a limit is broken; ellipsoids along it"]
            if deflections is not None:
                vectors = finite_array("deflections", deflections, (frames, 3))
                greatest = float(np.linalg.norm(vectors, axis=1).max())
                enlarged = ellipsoids.round_scale(greatest, ellipsoids.round_length(_ENLARGED * self._radius))
                self._panel["path"]["deflected"] = (enlarged * vectors).round(9).tolist()
                lines.append(f"orange: deflected, {enlarged:g} times; at most {1e6 * greatest:.3g} \u00b5m")
            nodes = ["/trace/line", "/trace/ellipsoids"]
            self._show(Entry(key="trace", title="Path", lines=lines, nodes=nodes, of_pose=False))
        self._update()

    def look(self, azimuth: float = -62.0, elevation: float = 17.0, closeness: float | None = None) -> None:
        """Point the camera so that the displayed machine fills the picture.

        Args:
            azimuth: azimuth of the camera seen from the machine, from x towards y [deg].
            elevation: elevation of the camera above the horizon [deg].
            closeness: 1 to fit the machine's bounding box, more for closer; by default close, but with the whole
                machine in the picture.
        """
        self._direction = (azimuth, elevation, closeness)
        serial = self._panel.get("camera", {}).get("serial", 0) + 1
        points = np.concatenate([self._bodies.outermost_points(self._configuration), *self._beside.values()])
        self._panel["camera"] = {
            "box": self._bodies.box(self._configuration).tolist(),
            "azimuth": azimuth,
            "elevation": elevation,
            "closeness": _NEAR if closeness is None else closeness,
            "points": [] if closeness else points.round(6).tolist(),
            "serial": serial,
        }
        self._update()

    def _reset_camera(self) -> None:
        if not self.is_served:  # no user can have turned the picture yet
            self.look(*self._direction)

    def _draw_ellipsoid(
        self,
        block: Array,
        kind: Motion,
        of: EllipsoidQuantity,
        others: OtherMotions,
        *,
        scale: float | None,
        explanation: str,
        at: str | ArrayLike | None = None,
        is_own: bool = True,
    ) -> DrawnEllipsoid:
        """Draw the ellipsoid of a 3 x 3 block; sliders update one at the tool if it is the description's own."""
        unit, place = UNITS[of, kind], at if isinstance(at, str) else "point"
        if scale is None:
            sizes = np.abs(np.linalg.eigvalsh(block))
            scale = self._kept_scale((kind, of, others), max(sizes.max(), _BULK * sizes.min()))
        drawn = DrawnEllipsoid.from_matrix(block, self._point(at), scale=scale, unit=unit)
        key, title, live = kind if at is None else f"{kind}_at_{place}", f"{kind.capitalize()} {of}", None
        if at is not None:
            title += f" at {at if isinstance(at, str) else 'a point'}"
        elif is_own and (sliders := self._live_sliders):
            live = sliders.live_ellipsoid(
                block, self._configuration, kind=kind, of=of, others=others, scale=scale, length=self._unit_length
            )
        path = f"/ellipsoids/{key}"
        if f"{path}/surface" not in self.scene.paths():
            ellipsoids.draw_ellipsoid(self.scene, path, kind)
        self.scene.set_transform(path, drawn.transform)
        self._beside[key] = drawn.position + np.concatenate([sign * drawn.transform[:3, :3].T for sign in _ROOM])
        self._reset_camera()
        self._show(
            Entry(
                key=key,
                title=title,
                lines=[scale_text(scale, self._unit_length, unit, "semi-axis"), explanation],
                values=numbers_with_unit(drawn.values[-self._space.count(kind) :], unit),
                colour=colours.css(ellipsoids.COLOURS[kind]),
                nodes=[path],
                live=live,
                principal=drawn.values.tolist(),
                unit=unit,
            )
        )
        return drawn

    def _program_source(self) -> str:
        return self._programs.source if self._programs is not None else ""

    def _still(self) -> str:
        return still_picture(self._bodies, self._configuration, *self._direction[:2])

    def _roles(self) -> list[Json]:
        """Return the roles of bodies if these show in their colours."""
        drawn = {part.colour[:3] for body in self._bodies for part in body.parts}
        present = {role_of(self.mechanism, body.joint) for body in self._bodies}
        roles = [role for role, own in colours.ROLES.items() if role in present or own in drawn]
        if not all(colours.ROLES[role] in drawn for role in roles):
            return []
        return [{"role": role, "colour": colours.css(colours.ROLES[role])} for role in roles]

    def _draw_bodies(self) -> None:
        for body in self._bodies:
            for part in body.parts:
                path = f"{body.parts_path}/{part.name}"
                self.scene.set_object(path, part.scene_object)
                self.scene.set_transform(path, part.placement)
        draw_surroundings(self.scene, self._box.mean(axis=0), self._radius, float(self._box[0, 2]))

    def _body_at(self, frame_name: str) -> tuple[str, Array]:
        """Return the path of the drawn body that moves with a frame, and the frame's placement in it."""
        frame = self.mechanism.model.frames[self.mechanism.frame_id(frame_name)]
        body = next((body for body in self._bodies if body.joint == frame.parentJoint), None)
        if body is None:  # not drawn yet
            body = DrawnBody(self.mechanism.model.names[frame.parentJoint], frame.parentJoint, np.eye(4))
            self._bodies = Bodies((*self._bodies, body))
            self.scene.set_transforms(Bodies((body,)).placements(self._configuration))
            if self._sliders is not None:
                self._panel["machine"] = self._sliders.machine_data(self._bodies)
        in_body: Array = np.linalg.inv(body.placement) @ frame.placement.homogeneous
        return body.path, in_body

    def _frame_of_path(
        self,
        configuration: Configuration,
        stiffness: ArrayLike | None,
        compliance: ArrayLike | None,
        forces: ArrayLike | None,
        of: EllipsoidMatrix,
        others: OtherMotions | None,
    ) -> tuple[dict[str, Array], Json]:
        """Display one frame of a path; return the transforms of everything that moves, and its notes."""
        self.display(configuration)
        transforms = self._bodies.placements(configuration)
        if stiffness is not None or compliance is not None:
            for kind in MOTIONS:
                drawn = self.stiffness_ellipsoid(stiffness, compliance=compliance, kind=kind, of=of, others=others)
                transforms[f"/ellipsoids/{kind}"] = drawn.transform
        if forces is not None:
            transforms |= self.actuator_forces(forces)
        values = {entry.key: entry.values for entry in self._entries.values() if entry.of_pose}
        said = {name: self._panel.get(name) for name in ("note", "warnings", "q")}
        return transforms, {**said, "values": values, "within": not broken_limits(self.mechanism, configuration)}

    @property
    def _live_sliders(self) -> Sliders | None:
        """The sliders if they can update what is drawn: with closed loops, and not within a path."""
        is_static = self._is_recording or not self._configuration.closure_residual < _CLOSED
        return None if is_static else self._sliders

    def _kept_scale(self, key: tuple[str, ...], greatest: float) -> float:
        """Return the scale [m per unit] of the first item of its kind, a round one that suits its greatest value."""
        return self._scales.setdefault(key, ellipsoids.round_scale(float(greatest), self._unit_length))

    def _point(self, at: str | ArrayLike | None) -> Array:
        if at is None:
            return np.array(self._configuration.tool_placement.translation)
        if isinstance(at, str):
            return np.array(self._configuration.frame_placement(at).translation)
        return finite_array("at", at, (3,))

    def _note(self, configuration: Configuration) -> tuple[list[str], list[str]]:
        """Return notes about a configuration, and the limits it breaks."""
        broken = list(map(str, broken_limits(self.mechanism, configuration)))
        warnings = [self._immobile] if self._immobile else []
        warnings += ["Outside the joint limits:", *broken] if broken else []
        lines = []
        at = self.mechanism.at([configuration.q])[0]
        for entry, values in zip(self._sets, (at.coordinates, at.commands), strict=False):
            shown = [reading(number, float(value)) for number, value in zip(entry["numbers"], values, strict=True)]
            if sum(map(len, shown)) <= LONG_READING:  # others are left to their sliders
                lines.append(", ".join(shown))
        if self.mechanism.closures:
            residual = configuration.closure_residual
            state = "closed to" if residual < _CLOSED else "open by"
            lines.append(f"loops {state} {f'{residual:.0e}' if residual else 0} m")
        return lines, warnings


def _load_text(wrench: Array) -> str:
    """Describe a load, as in "a force along z"."""
    if np.count_nonzero(wrench) != 1:
        return "the load " + ", ".join(f"{number:g}" for number in wrench) + " N, N m"
    axis = int(np.flatnonzero(wrench)[0])
    return f"{'a force along' if axis < 3 else 'a moment about'} {'xyz'[axis % 3]}"


def _distances_to_singularities(configurations: Sequence[Configuration]) -> dict[str, list[float]]:
    """Return the distance to each type of singularity along a path; empty if there is none to measure."""
    try:
        generic = instantaneous_mobility(generic_configuration(configurations[0]))
        measured = [singularity_distances(configuration, generic=generic) for configuration in configurations]
    except PM3DofError:
        return {}
    return {kinds[0].type: [kind.measure for kind in kinds] for kinds in zip(*measured, strict=True)}
