"""All checks on one robot, for people: what passed, what did not, and what the robot is."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from osc_contact.errors import ModelError
from osc_contact.robots.findings import ModelFinding
from osc_contact.robots.geometry import check_mesh_files
from osc_contact.robots.inertias import Inertias
from osc_contact.robots.limits import JointLimits
from osc_contact.robots.loading import load
from osc_contact.robots.mjcf import compile_mjcf, is_mjcf, load_mjcf
from osc_contact.robots.mjcf_parts import placement_difference
from osc_contact.robots.model import SAMPLES
from osc_contact.robots.second_reader import compare
from osc_contact.robots.summary import RobotSummary, summarise, summarise_mjcf

__all__ = ["RobotReport", "check_robot"]


@dataclass(frozen=True)
class RobotReport:
    """The verdict on a URDF.

    Attributes:
        file: the URDF. findings: what is wrong with it, empty for a sound robot.
        load_ms: time of the checked load. reader_difference: largest difference of a link
            placement from the second reader (m or without unit).
        meshes_missing: mesh files that were not found (they are not needed for the dynamics).
        summary: the robot, None if it was refused.
    """

    file: Path
    findings: tuple[ModelFinding, ...]
    load_ms: float = 0.0
    reader_difference: float = 0.0
    meshes_missing: int = 0
    summary: RobotSummary | None = None

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def lines(self) -> list[str]:
        """The verdict in plain words."""
        if self.summary is None:
            count = f"{len(self.findings)} finding{'s' if len(self.findings) > 1 else ''}"
            return [*map(str, self.findings), f"{self.file}: refused, {count}"]
        robot = self.summary
        lines = [
            f"{self.file}: sound, loaded in {self.load_ms:.1f} ms",
            f"{robot.dof} joints move, {robot.links} links, {robot.mass:.4g} kg of which "
            f"{robot.moving_mass:.4g} kg move; mass matrix positive definite at {SAMPLES + 1} "
            f"configurations; a second reader differs by {self.reader_difference:.1g} at most",
        ]
        if robot.joints:
            lines.append(f"joints: {robot.loss_words}")
        if self.meshes_missing:
            lines.append(f"{self.meshes_missing} mesh files were not found (not needed here)")
        if robot.more_tips:
            lines.append(f"{robot.more_tips} more tips are not shown: name one with --tip")
        return lines

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        keys = ("check", "line", "column", "element", "reason", "cure")
        return {
            "file": str(self.file),
            "sound": self.sound,
            "findings": [{key: getattr(f, key) for key in keys} for f in self.findings],
            "load_ms": self.load_ms,
            "reader_difference": self.reader_difference,
            "meshes_missing": self.meshes_missing,
            "robot": None if self.summary is None else self.summary.as_dict(),
        }


def check_robot(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
    tip: str | None = None,
) -> RobotReport:
    """Load a URDF with all checks, mesh files and the second reader included, and describe it.

    An MJCF file is compiled by MuJoCo, whose kinematics are the second reader.

    Args:
        path, limits: as for `load_model`, or `load_mjcf`. inertias, package_dirs: of a URDF.
        tip: the frame to describe; default: one at each end of the tree.

    Raises:
        ModelError: there is no such file, or no such frame.
        InvalidInputError: limits for joints that do not exist.
    """
    file = Path(path)
    if is_mjcf(file):
        return _check_mjcf(file, limits, tip)
    start = time.perf_counter()
    try:
        loaded = load(file, limits=limits, inertias=inertias, package_dirs=package_dirs)
        load_ms = 1e3 * (time.perf_counter() - start)
        missing = check_mesh_files(loaded.document, loaded.package_dirs)
        loaded.document.require()
        difference = compare(loaded.model, file)
    except ModelError as error:
        if not error.findings or not file.is_file():
            raise
        return RobotReport(file, error.findings)
    summary = summarise(loaded.model, loaded.document, tip)
    return RobotReport(file, (), load_ms, difference, len(missing), summary)


def _check_mjcf(
    file: Path, limits: Mapping[str, JointLimits] | None, tip: str | None
) -> RobotReport:
    start = time.perf_counter()
    try:
        mj = compile_mjcf(file)
        model = load_mjcf(mj, tip, limits=limits)
        load_ms = 1e3 * (time.perf_counter() - start)
        difference = placement_difference(mj, model)
    except ModelError as error:
        if isinstance(error.__cause__, ImportError):
            raise
        return RobotReport(file, (ModelFinding("mjcf", file, 0, 0, "", str(error), ""),))
    mass = float(mj.body_subtreemass[0])
    return RobotReport(
        file, (), load_ms, difference, 0, summarise_mjcf(model, file.stem, mass, tip)
    )
