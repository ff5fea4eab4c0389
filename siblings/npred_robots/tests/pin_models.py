"""Pinocchio's model of a chain of bodies, joint by joint."""

from typing import Any

from npred_robots.rigid_body import Body


def model(pin: Any, bodies: list[Body]) -> tuple[Any, Any]:
    """The library's model and data of bodies that turn about their z."""
    chain, parent = pin.Model(), 0
    for body in bodies:
        parent = chain.addJoint(parent, pin.JointModelRZ(), pin.SE3(body.turn, body.position), body.joint)
        chain.appendBodyToJoint(parent, pin.Inertia(body.mass, body.centre, body.inertia), pin.SE3.Identity())
    return chain, chain.createData()
