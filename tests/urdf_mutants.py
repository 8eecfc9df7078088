"""Random mutants of sound URDFs, judged by the loader and by an independent mass matrix.

Run as ``python urdf_mutants.py SEED COUNT``: it prints one line of JSON. It is a program of its own
because the caller looks for crashes of the process.
"""

import json
import random
import re
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin
from robot_numbers import numbers, placement, written_inertia
from urdf_corpus import GOOD

from osc_contact import robots
from osc_contact.errors import ModelError

NASTY = (
    "nan",
    "inf",
    "-inf",
    "1e400",
    "-1e308",
    "1e-320",
    "0",
    "-0.0",
    "-1",
    "1e-9",
    "1e6",
    "0,5",
    "",
    "0x10",
    "1_0",
    "one",
    "1e5 2",
    " ",
    "9" * 400,
    "-0.001",
    "5",
    "0.3",
)
WORDS = (
    "revolute",
    "continuous",
    "prismatic",
    "fixed",
    "floating",
    "base",
    "hand",
    "slide",
    "tool",
    "universe",
    "parent",
    "link",
    "joint",
    "xyz",
    "rpy",
    "lower",
    "mimic",
    "inertial",
    "mass",
    "DOCTYPE",
    "\x01",
    "é",
    "%s%n",
    "../",
    "<",
    "&lt;",
    "]]>",
    "<!--",
)
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
WORD = re.compile(r"[A-Za-z_]{3,}")


def mutant(rng, text):
    """Bytes of a text after one to four random changes of numbers, words, lines, spans or bytes."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        kind = rng.randrange(-4, 8)
        if kind <= 2:
            text = _exchange(rng, text, NUMBER, NASTY if kind > 0 else None)
        elif kind == 3:
            text = _exchange(rng, text, WORD, WORDS)
        elif kind in (4, 5):
            lines = text.splitlines(keepends=True)
            i = rng.randrange(len(lines))
            j = rng.randrange(len(lines))
            if kind == 4:
                del lines[i : i + rng.choice((1, 1, 1, 4))]
            else:
                lines.insert(j, lines[i])
            text = "".join(lines)
        elif kind == 6:
            i = rng.randrange(len(text) + 1)
            text = text[:i] + text[i + rng.randrange(30) :]
        else:
            raw = bytearray(text.encode())
            for _ in range(rng.randrange(1, 4)):
                raw[rng.randrange(len(raw))] = rng.randrange(256)
            return bytes(raw)
        text = text or " "
    return text.encode()


def _exchange(rng, text, pattern, by):
    """Replace a random match of a pattern in a text by one of several words.

    Args:
        rng: random numbers.
        text: the text.
        pattern: regular expression.
        by: words; None: the number is multiplied by a random factor.
    """
    hits = list(pattern.finditer(text))
    if not hits:
        return text
    hit = rng.choice(hits)
    if by is None:  # another size, another sign
        factor = rng.choice((-1, 1)) * 10 ** rng.uniform(-6, 3)
        new = repr(float(hit[0]) * factor)
    else:
        new = rng.choice(by)
    return text[: hit.start()] + new + text[hit.end() :]


# Independent mass matrix --------------------------------------------------------------------------


def mass_matrix(text, names, q):
    """Compute M(q) = Σ JᵀIJ over the links from the text of a URDF.

    Args:
        text: the text.
        names: names of the moving joints, in the order of q.
        q: (n,) positions.
    """
    root = ElementTree.fromstring(text)
    links = {link.get("name"): link for link in root.findall("link")}
    above = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    pending = [name for name in links if name not in above]
    jacobians = {pending[0]: np.zeros((6, len(names)))}  # each in the frame of its link
    M = np.zeros((len(names), len(names)))
    while pending:
        parent = pending.pop()
        J = jacobians[parent]
        if links[parent].find("inertial") is not None:
            M += J.T @ written_inertia(links[parent]).matrix() @ J
        for child, joint in above.items():
            if joint.find("parent").get("link") != parent:
                continue
            X = placement(joint)
            S = np.zeros((6, len(names)))
            kind = joint.get("type")
            if kind != "fixed":
                given = joint.find("axis")
                axis = numbers("1 0 0" if given is None else given.get("xyz"))
                i = names.index(joint.get("name"))
                S[slice(3) if kind == "prismatic" else slice(3, 6), i] = axis / np.linalg.norm(axis)
                X = X * pin.exp6(S[:, i] * q[i])
            jacobians[child] = X.toActionMatrixInverse() @ J + S
            pending.append(child)
    return M


def judge(text, model, rng):
    """Compare Pinocchio's M of a loaded model with `mass_matrix` at random positions.

    Returns:
        Largest difference, and smallest eigenvalue, both of M scaled to unit diagonal.
    """
    q = rng.uniform(-2, 2, model.nq)
    M = mass_matrix(text, list(model.names)[1:], q)
    scale = 1 / np.sqrt(np.abs(M.diagonal()) + 1e-300)
    ours = np.array(pin.crba(model, model.createData(), q))
    ours = np.triu(ours) + np.triu(ours, 1).T
    off = float(np.abs(scale[:, None] * (ours - M) * scale).max())
    return (off, float(np.linalg.eigvalsh(scale[:, None] * M * scale).min()))


def main(seed, count):
    """Load `count` mutants and print the results as JSON."""
    rng = random.Random(seed)
    numpy_rng = np.random.default_rng(seed)
    scara = robots.urdf_path("scara_left").read_text()
    plain = re.sub(r"\s*<(visual|collision)\b.*?</\1>", "", scara, flags=re.DOTALL)
    checks = Counter()
    slowest = 0.0
    worst_off = 0.0
    least = np.inf
    broken = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            file = Path(folder) / f"{number}.urdf"  # truncating one file would wait for the disk
            text = mutant(rng, plain if rng.random() < 0.2 else GOOD)
            file.write_bytes(text)
            start = time.perf_counter()
            try:
                model = robots.load_model(file)
                verdict = "accepted"
            except ModelError as error:
                verdict = error.findings[0].check if error.findings else "no finding"
            file.unlink()
            slowest = max(slowest, time.perf_counter() - start)
            checks[verdict] += 1
            if verdict != "accepted" or model.nv == 0:
                continue
            off, eigenvalue = judge(text, model, numpy_rng)
            worst_off = max(worst_off, off)
            least = min(least, eigenvalue)
            if not (off < 1e-6 and eigenvalue > 1e-12):
                broken.append(text.decode("utf-8", "replace"))
    print(
        json.dumps(
            {
                "mutants": count,
                "verdicts": dict(checks),
                "slowest_ms": 1e3 * slowest,
                "largest_difference": worst_off,
                "least_eigenvalue": least,
                "broken": broken,
            }
        )
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
