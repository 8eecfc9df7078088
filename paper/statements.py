"""Statements of the paper's eight figures, in our words, and the form of an answer to them.

The paper's text gives no numbers for its plots: statements are compared, not curves. A figure is
made by `paper.figures` or by the study of the same name, which answers the statements by their
keys. Statements without an answer are reported as open.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple


class PaperFigure(NamedTuple):
    """A figure of the paper.

    Attributes:
        name: "fig1" …, also of what reproduces it.
        shows: caption of the figure.
        states: statements of caption and text about it, by key.
    """

    name: str
    shows: str
    states: Mapping[str, str]


class Answer(NamedTuple):
    """Our answer to a statement.

    Attributes:
        found: the numbers, in words.
        holds: whether they bear the statement out.
        limit: the limit under which it holds, in words; empty where it is plain.
    """

    found: str
    holds: bool
    limit: str = ""


class Verdict(StrEnum):
    """Verdict on a reproduced figure."""

    reproduced = "reproduced"
    partly = "partly reproduced"
    contradicted = "contradicted"


def judge(figure: PaperFigure, answers: Mapping[str, Answer], drawn: bool = True) -> Verdict:
    """The verdict on one figure.

    Args:
        figure: figure of the paper.
        answers: by the keys of its statements; those that fail outweigh those that lack.
        drawn: whether there is a picture of ours; without one nothing counts as reproduced.
    """
    given = [answers[key] for key in figure.states if key in answers]
    if not all(answer.holds for answer in given):
        return Verdict.contradicted
    whole = drawn and len(given) == len(figure.states)
    return Verdict.reproduced if whole else Verdict.partly


PAPER: tuple[PaperFigure, ...] = (
    PaperFigure(
        "fig1",
        "A body touches its environment in two points; the two contact normals are skew.",
        {
            "skew": "The normals are neither parallel nor do they meet.",
            "frame": "Wherever a constraint frame is put, no two of its directions span the space "
            "of the two normals: the Raibert–Craig model does not describe this contact.",
            "inspection": "N can be written down by inspection: its columns are the two contact "
            "forces.",
        },
    ),
    PaperFigure(
        "fig2",
        "A cone lies in a groove.",
        {
            "freedoms": "The cone keeps two freedoms: it turns about its axis and slides along "
            "the groove.",
            "axes": "The axes of the two motions are neither parallel nor perpendicular.",
            "frame": "The Raibert–Craig model does not describe this contact.",
        },
    ),
    PaperFigure(
        "fig3",
        "The workcell: two arms, a camera above them, and the two-contact task.",
        {
            "arms": "Two SCARA-type arms with four driven joints each hold a metal rod of about "
            "60 cm.",
            "hinges": "Hinges in the grippers let the rod turn; both arms together move it in five "
            "degrees of freedom.",
            "vision": "An overhead vision system follows the arms and what they touch.",
            "contacts": "Both ends of the rod touch the environment, as in fig. 1.",
        },
    ),
    PaperFigure(
        "fig4",
        "The architecture of the decoupled force/motion controller.",
        {
            "filters": "Force and motion have controllers of their own. What they command is "
            "filtered by the contact model before it is joined.",
            "update": "The contact model, a 6×2 matrix N, is brought up to date continuously as "
            "arms and object move.",
        },
    ),
    PaperFigure(
        "fig5",
        "Force control in the space N.",
        {
            "path": "Measured forces pass Ω_f and a generalised inverse of N, are compared with "
            "the desired magnitudes, corrected, joined by the desired force as feed-forward, and "
            "go back to operational space through N.",
            "filter": "Ω_f takes out of the wrist readings what the accelerated object adds to "
            "them.",
            "motion": "The force controller does not disturb the control of motion.",
        },
    ),
    PaperFigure(
        "fig6",
        "Power while the contacts are kept, with and without projection.",
        {
            "reciprocal": "The projected contact forces deliver no power: reciprocity holds while "
            "the constraints are respected.",
            "total": "The power of the unprojected force includes that of moving the object.",
        },
    ),
    PaperFigure(
        "fig7",
        "Power while contacts are lost, with and without projection.",
        {
            "violated": "Where the constraints are not respected, the projected forces deliver "
            "power.",
            "peaks": "Every peak is a collision between rod and environment.",
        },
    ),
    PaperFigure(
        "fig8",
        "Force control in several contacts: both contact forces, desired and measured.",
        {
            "follow": "The measured forces of both contacts follow the desired ones.",
            "space": "They are controlled in the two-dimensional space N, which the Raibert–Craig "
            "model cannot describe.",
        },
    ),
)
