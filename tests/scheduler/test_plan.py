"""What enters the question of a stage: keys of a loop past the paper's, and laws of files by what they hold."""

from conftest import settings_of

from npred.lab import config
from npred.lab.scheduler.plan import nodes, usual

LAW = """
from npred import DelayLaw

class Own(DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t):
        return {factor} * D_hat  # {comment}
"""


def evaluate_question(**tables):
    made = config.parse({"plant": "scalar"} | tables, "tests")
    node = next(node for node in nodes(made, usual(made)) if node.name == "evaluate")
    return settings_of(node, made)["evaluate"]


def test_each_key_of_a_real_loop_enters_the_question():
    plain = evaluate_question()
    defaults = {"actuator": "measured", "measurement": {"noise": 0.0}, "disturbance": {"omega": 1.0}, "truth": {}}
    assert evaluate_question(evaluate=defaults | {"scenarios": []}) == plain
    others = {"actuator": "history", "measurement": {"noise": 0.1}, "truth": {"a": 0.6}}
    others |= {"disturbance": {"amplitude": 0.1}, "scenarios": [{"name": "a"}]}
    for key, value in others.items():
        changed = evaluate_question(evaluate={key: value})
        assert {name for name in changed if changed[name] != plain[name]} == {key}


def test_the_law_of_a_scenario_enters_by_what_its_file_holds(tmp_path):
    answers = []
    for folder, factor, comment in (("a", 0, "one"), ("b", 0, "another"), ("c", 1, "one")):
        path = tmp_path / folder / "own.py"
        path.parent.mkdir()
        path.write_text(LAW.format(factor=factor, comment=comment))
        scenario = {"name": "own law", "adaptation": f"{path}:Own"}
        answers.append(evaluate_question(evaluate={"scenarios": [scenario]})["scenarios"])
    assert answers[0] == answers[1] != answers[2]
