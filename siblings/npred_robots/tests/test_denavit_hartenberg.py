"""Chains by their Denavit-Hartenberg table: frames, tensors, and Pinocchio on the same bodies."""

import numpy as np
import pin_models
import pytest

from npred.base.errors import ConfigError
from npred_robots import baxter, denavit_hartenberg, rigid_body
from npred_robots.denavit_hartenberg import Link

BODIES = denavit_hartenberg.bodies(baxter.LINKS)
Q, RATES, PULL = np.random.default_rng(0).uniform(-1, 1, (3, 7))


def test_a_rod_is_a_pendulum():
    """One link along x of its own frame, its joint level: a pendulum of the angle to the horizontal."""
    rod = Link("swing", 0.0, 0.5, 0.0, 2.0, (-0.25, 0.0, 0.0), (0.0, 1 / 24, 1 / 24), (0.0, 0.0, 0.0))
    level = Link("level", 0.0, 0.0, np.pi / 2, 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    bodies = denavit_hartenberg.bodies([level, rod])
    assert rigid_body.mass_matrix(bodies, [0.0, 0.3], np)[1][1] == pytest.approx(2.0 * 0.5**2 / 3)
    load = rigid_body.torques(bodies, [0.0, 0.3], [0.0, 0.0], [0.0, 0.0], 9.81, np)[1]
    assert load == pytest.approx(2.0 * 9.81 * 0.25 * np.cos(0.3))


def test_pinocchio_agrees_on_both_arms():
    """Mass matrix, loads and accelerations of the first five bodies and of all seven."""
    pin = pytest.importorskip("pinocchio", reason="needs the extra npred[pin]")
    for joints in (5, 7):
        model, data = pin_models.model(pin, BODIES[:joints])
        q, rates, pull = Q[:joints], RATES[:joints], PULL[:joints]
        H = np.array(rigid_body.mass_matrix(BODIES[:joints], list(q), np), float)
        upper = np.triu(pin.crba(model, data, q))
        np.testing.assert_allclose(np.triu(H), upper, atol=1e-13)
        torques = rigid_body.torques(BODIES[:joints], list(q), list(rates), list(pull), 9.81, np)
        np.testing.assert_allclose(np.array(torques, float), pin.rnea(model, data, q, rates, pull), atol=1e-12)


def test_the_products_of_baxters_long_links_lie_along_them():
    """Links 1, 3 and 5 reach from their joint at (-a, d) to their frame: mass spread along that line has ∫ x y dm < 0,
    the sign that stands in the table. As entries of the tensor the same numbers would tilt the links across.
    """
    for link in (baxter.LINKS[0], baxter.LINKS[2], baxter.LINKS[4]):
        spread = np.trace(link.inertia) / 2 * np.eye(3) - link.inertia  # ∫ r r' dm about the centre
        assert np.linalg.eigvalsh(spread).min() > 0
        assert -link.a * link.d * spread[0, 1] > 0


@pytest.mark.parametrize(
    ("links", "message"),
    [((), "expected at least one link"), ((baxter.LINKS[0]._replace(mass=0.0),), "s0 expected a mass above 0")],
)
def test_a_table_without_masses_is_refused(links, message):
    with pytest.raises(ConfigError, match=message):
        denavit_hartenberg.bodies(links)
