"""The paper's plant: what every plant must show; its golden numbers are in test_plants and test_closed_loop."""

import plant_claims

from npred import plants


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = plants.resolve("activator_repressor"), 2.0, (0.03, 30.0), 60.0
    pipeline = "paper"
