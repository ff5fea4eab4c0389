"""Two strict-feedforward plants whose prediction is a polynomial of integrals of the commands."""


class StrictFeedforward2:
    """z1' = z2 - c z2² U(t - D), z2' = U(t - D): the second-order example of Krstic (IEEE TAC 55, 2010, 287-303).

    y = z1 + c z2³ / 3 makes it two integrators, y' = z2, and the law U = -y - 2 z2 gives both poles at -1: the loop,
    the prediction and the commands have formulas (docs/plants/strict_feedforward.md).
    """

    states = ("z1", "z2")
    inputs = ("u",)
    parameters = {"c": 1.0}
    box = {"z1": (-1.0, 1.0), "z2": (-1.0, 1.0)}

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        return [x.z2 - p.c * x.z2**2 * u.u, u.u]

    @staticmethod
    def kappa(x, t, p, M):
        """The law without delay."""
        return [-x.z1 - 2 * x.z2 - p.c * x.z2**3 / 3]

    @staticmethod
    def V(x, t, p, M):
        """(3 y² + 2 y z2 + z2²) / 2: V' = -y² - z2² along the loop of kappa, everywhere."""
        y = x.z1 + p.c * x.z2**3 / 3
        return 1.5 * y**2 + y * x.z2 + 0.5 * x.z2**2


class StrictFeedforward3:
    """z1' = z2 + z3², z2' = z3 + z3 U(t - D), z3' = U(t - D): the third-order example of the same article.

    No change of coordinates makes it linear. The law is that of forwarding: with
        ζ2 = z2 + z3 - z3² / 2,   ζ1 = z1 + 2 ζ2 - z3 + 3 (2 z3² - 2 z3 ζ2 + ζ2²) / 8,
    U = -z3 - ζ2 - (1 + 3 z3 / 4) ζ1, whose linear part puts all poles at -1.
    """

    states = ("z1", "z2", "z3")
    inputs = ("u",)
    box = {"z1": (-1.0, 1.0), "z2": (-1.0, 1.0), "z3": (-1.0, 1.0)}

    @staticmethod
    def f(x, u, t, p, M):
        """The dynamics."""
        return [x.z2 + x.z3**2, x.z3 + x.z3 * u.u, u.u]

    @staticmethod
    def kappa(x, t, p, M):
        """The law without delay."""
        first, second = _forwarded(x)
        return [-x.z3 - second - (1 + 0.75 * x.z3) * first]

    @staticmethod
    def V(x, t, p, M):
        """ζ1² + ζ2² + z3²: with w = (1 + 3 z3 / 4) ζ1, V' = -w² - ζ2² - z3² - (w + ζ2 + z3)² along the loop of
        kappa."""
        first, second = _forwarded(x)
        return first**2 + second**2 + x.z3**2


def _forwarded(x):
    """ζ1 and ζ2."""
    second = x.z2 + x.z3 - 0.5 * x.z3**2
    return x.z1 + 2 * second - x.z3 + 0.375 * (2 * x.z3**2 - 2 * x.z3 * second + second**2), second


PLANTS = {"strict_feedforward2": StrictFeedforward2, "strict_feedforward3": StrictFeedforward3}
