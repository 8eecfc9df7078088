"""Ticks of the law as a whole: what they allocate, copy, accept and agree with.

Torques, forces and motions are judged in tests/test_law_kkt.py.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import model_error
from processes import python
from rigs import placed, random_faces, unit, vector

import osc_contact as osc
from osc_contact.dynamics.chain_results import require_pinocchio_agrees
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.law.records import MODEL


def inputs(chain, q, v, rng, columns, touched=None):
    """Any readings, and a reference somewhat off."""
    X = chain.state(q, v).X_WO * pin.exp6(0.02 * rng.standard_normal(6))
    wrenches = 10 * rng.standard_normal((len(chain.arms), 6))
    alpha_d = rng.uniform(5, 20, columns)
    squeeze = 5.0 if len(chain.arms) < 3 else 0.0  # more than two are the readable path's
    reference = Reference(X, 0.1 * rng.standard_normal(6), rng.standard_normal(6), alpha_d, squeeze)
    return (Measurement(q, v, wrenches, touched), reference)


def motion_of(rng, contacts):
    """Bodies displaced by some centimetres and turned by some tenths of a radian."""
    spread = np.repeat([0.05, 0.3], 3)
    X = np.array([pin.exp6(spread * rng.standard_normal(6)).homogeneous for _ in range(contacts)])
    X = X.reshape(contacts, 4, 4)
    A = rng.standard_normal((contacts, 6))
    return Touched(X, rng.standard_normal((contacts, 6)), A)


def off_their_faces(X, r, rng):
    """Vertices somewhat above or below their faces: friction acts where the face is."""
    pairs = random_faces(X, r, rng)
    return [replace(p, point=p.point + 0.01 * rng.standard_normal(3), radius=0.005) for p in pairs]


COUNT_ALLOCATIONS = """
import gc
import sys
import numpy as np
import osc_contact as osc

rig = osc.build_rig(osc.load_scenario("two_contact_rod_friction"))
from benchmarks.cases import repeatable
controller, measurement = repeatable(rig.controller()), rig.plant().measure()
reference = rig.references.at(0.0)
for _ in range(2000):
    controller.tick(measurement, reference)
assert controller.status is osc.Status.OK, controller.reason
counts = []
for _ in range(6):
    gc.collect()  # what waits for it is no leak
    counts.append(sys.getallocatedblocks())
    for _ in range(20_000):
        controller.tick(measurement, reference)
        controller.motion_integral = np.zeros(6)
        controller.force_integral = np.zeros(0)
assert controller.status is osc.Status.OK, controller.reason
grown = np.diff(counts)  # now and then Python allocates for itself, a leak does in every part
assert grown.min() < 5, grown
print("still")
"""


def test_a_hundred_thousand_ticks_allocate_nothing():
    """In Python; that the compiled law cannot allocate is seen in test_without_python."""
    assert python("-c", COUNT_ALLOCATIONS).stdout == "still\n"


def test_the_front_end_is_pinocchios_and_a_foreign_model_is_refused():
    """J, M and h, wherever a chain is made; joints about and along any axis; a wrong model."""
    pin.seed(41)
    model = pin.Model()
    joint = 0
    X = placed(0.1, 0.2, 0.3, (0.3, -0.2, 0.5))
    axis = unit(vector(0.3, -0.5, 0.8))
    kinds = [
        pin.JointModelRX(),
        pin.JointModelPY(),
        pin.JointModelRevoluteUnaligned(*axis),
        pin.JointModelPrismaticUnaligned(*axis),
        pin.JointModelRY(),
        pin.JointModelRZ(),
        pin.JointModelPZ(),
    ]
    for i, kind in enumerate(kinds):
        joint = model.addJoint(joint, kind, X, f"joint{i}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
        X = pin.SE3.Random()
    model.upperEffortLimit[:] = 50.0
    model.addFrame(pin.Frame("tip", joint, 0, placed(0.2), pin.FrameType.OP_FRAME))
    body = osc.RigidObject(pin.Inertia(1.0, vector(0.02, 0.01, 0.0), 0.01 * np.eye(3)))
    chain = osc.ClosedChain([osc.Arm.from_urdf(model, name="arm", tip="tip")], payload=body)
    wrong_link = chain.law_row(from_leader=False).copy()
    MODEL.view(wrong_link).joints.link[3][0] *= 1.0 + 1e-6
    wrong_rotor = chain.law_row(from_leader=False).copy()
    MODEL.view(wrong_rotor).joints.armature[3] += 0.1
    for row in (wrong_link, wrong_rotor):
        with model_error("law's .* differs from Pinocchio"):
            require_pinocchio_agrees(chain, row)
