"""The figures: one look a predictor, the same bytes for the same data, SVG that a page can hold."""

import itertools
import re
from dataclasses import replace
from threading import Event, Thread
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas
from result_samples import MAP, RADIUS, scores, timing

from npred import plants
from npred.lab import config
from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, PredictorId, ranked
from npred.lab.config.results.evaluate import Conditions, Scores
from npred.lab.report import figures
from npred.lab.report.figures import accuracy
from npred.lab.report.figures import figure as figure_module
from npred.lab.report.figures.evaluation_data import ErrorArrays, EvaluationData, Histogram, LoopSeries
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, inline, write
from npred.lab.report.figures.style import MEDIA, ROLES, SCREEN, LineStyle, colours, line_of, log, medium

SVG = "{http://www.w3.org/2000/svg}"
NAMES = tuple(map(PredictorId.parse, ("numerical", "no_adaptation", "deeponet@2", "deeponet", "fno")))
DEEPONET, FNO = PredictorId("deeponet"), PredictorId("fno")


def row(number: int, lost: bool = False) -> Scores:
    eps = 0.0 if number < 2 else 10.0**-number
    cells = MAP | {"converged": [[True] * 3, [not lost] * 3]}
    radius = RADIUS | {"median": None if lost else 1e-9, "worst": None if lost else 1e-5}
    return scores(eps_kappa=eps, eps_sup=eps, radius=radius, map=cells)


def found(plant: str = "activator_repressor", lost: bool = False) -> EvaluationData:
    """Five loops that decay, or whose networks diverge, and the errors of three networks."""
    made = plants.resolve(plant)
    t, rng = np.linspace(0, 10, 101), np.random.default_rng(1)
    decay = np.exp(-t)[:, None]
    target = made.target(t) + decay
    loops = {n: LoopSeries(t, target.copy(), made.u_target(t) + decay, 1 + decay[:, 0], 1 + decay[:, 0]) for n in NAMES}
    if lost:
        for name in (NO_ADAPTATION, DEEPONET):
            loops[name].X[50:], loops[name].N[50:] = np.nan, np.inf
    X, D_hat = rng.uniform(0, 1, (60, made.n)), rng.uniform(0.3, 2, 60)
    errors = {name: ErrorArrays(rng.lognormal(size=60), np.sort(rng.lognormal(size=(11, 3)))) for name in NAMES[2:]}
    by_kind = {kind: {name: rng.lognormal(size=9) for name in errors} for kind in ("nominal", "exploring", "redrawn")}
    edges = np.linspace(0, 1, 11)
    density = {name: rng.uniform(size=10) for name in (NUMERICAL, FNO)}
    covered = {name: Histogram(edges, np.ones(10), density) for name in (*made.states, *made.inputs, "D_hat")}
    models = {name: row(k, lost and name == DEEPONET) for k, name in enumerate(NAMES)}
    evaluate = config.parse({"plant": plant, "evaluate": {"X0": [0.5] * made.n}}, "test").evaluate
    return EvaluationData(made, evaluate, models, 110.0, loops, X, D_hat, errors, covered, by_kind)


KINDS = (
    figures.figure1, figures.certificate, figures.errors, figures.kinds, figures.box, figures.delays, figures.coverage,
)  # fmt: skip


def test_a_contender_looks_the_same_everywhere_and_like_no_other():
    looks = {name: (line_of(name).role, line_of(name).dash) for name in NAMES}
    assert len(set(looks.values())) == len(NAMES)
    for figure in (kind(found()) for kind in KINDS):
        for key in figure.legend:
            for name in NAMES:
                if key.label == name.label:
                    assert key.style == line_of(name)


def test_networks_of_any_name_look_like_no_other_and_no_numerical_predictor():
    numerical = {"ink", "muted", "green", "frozen", line_of(NUMERICAL).role, line_of(NO_ADAPTATION).role}
    names = ("mine", "my_net", "green", "published", "averaging", "gru", "deeponet", "fno")
    predictors = ranked(PredictorId(name, epoch) for name in names for epoch in (None, 7))
    assert len({(line_of(predictor).role, line_of(predictor).dash) for predictor in predictors[:4]}) == 4
    assert (
        len({(line_of(predictor).role, line_of(predictor).dash) for predictor in predictors if predictor.epoch is None})
        == 8
    )
    assert not {role for predictor in predictors for role in colours(predictor)} & numerical
    assert [ranked([predictor])[0].rank for predictor in predictors] == [0] * len(predictors)


def test_the_runtimes_of_two_networks_of_ones_own_can_be_told_apart():
    rows = [timing(name, "torch", copies=copies) for name in ("mine", "yours") for copies in (None, True)]
    keys = {key.label: key.style for key in figures.speed([*rows, timing("rk4")]).legend}
    assert list(keys)[:2] == ["RK4", "mine, torch"] and len(keys) == len(set(keys.values())) == 5
    assert keys["mine, torch"].role == line_of(ranked(map(PredictorId, ("mine", "yours")))[0]).role


def test_colours_are_as_many_as_roles_on_light_and_on_dark():
    for shade in (0, 1):
        assert len({colours[shade] for colours in ROLES.values()}) == len(ROLES)


@pytest.mark.parametrize(("plant", "lost"), [("activator_repressor", False), ("scalar", True), ("planar_arm2", True)])
def test_every_figure_of_every_plant_can_be_drawn_and_is_told_in_words(plant, lost):
    evaluation = found(plant, lost)
    for kind in KINDS:
        figure = kind(evaluation)
        assert figure.caption.endswith(".") and figure.title
        for panel in figure.panels:
            assert len(panel.alt) > len(panel.title) and "nan" not in panel.title
            ElementTree.fromstring(inline(panel, "p"))


def test_figure_1_has_a_panel_a_quantity_and_the_differences_of_loops_that_lie_on_each_other():
    evaluation, quantities = found(), ["x_{1}", "x_{2}", "U", "delay estimate D̂ (s)"]
    assert [panel.title for panel in figures.figure1(evaluation).panels] == quantities  # all loops are the same
    apart = replace(evaluation.loops[FNO], X=evaluation.loops[FNO].X + np.array([3e-7, 4e-7]))
    figure = figures.figure1(replace(evaluation, loops=evaluation.loops | {FNO: apart}))
    assert [panel.title for panel in figure.panels] == [*quantities, "difference from the numerical loop"]
    axis = Canvas().subplots()
    figure.panels[-1].draw(axis)
    (line,) = axis.lines
    np.testing.assert_allclose(np.asarray(line.get_ydata()), 5e-7, rtol=1e-6)
    assert figure.caption.endswith("differ from the numerical loop by at most: FNO 5.0·10⁻⁷.")


def test_the_loop_within_other_bounds_is_a_figure_of_its_own_and_both_say_what_u_may_be():
    evaluation = found()
    assert figures.figure1_bounded(evaluation) is None and "without bounds" not in figures.figure1(evaluation).caption
    within = {name: replace(loop, U=loop.U * 0) for name, loop in evaluation.loops.items()}
    config = evaluation.config.model_copy(update={"figure_bounds": [(0.0, np.inf)]})
    both = replace(evaluation, config=config, bounded=within)
    figure, free = figures.figure1_bounded(both), figures.figure1(both)
    assert figure and (figure.name, free.name) == ("figure1_bounded", "figure1")
    assert "U in [0, ∞]" in figure.caption and "U without bounds" in free.caption
    U = [panel.alt for panel in figure.panels if panel.title == "U"]
    assert U and "numerical 0 to 0" in U[0] and "numerical 0 to 0" not in free.panels[2].alt


def test_the_density_of_the_coverage_has_an_axis_with_numbers():
    for panel in figures.coverage(found()).panels:
        axis = Canvas().subplots()
        panel.draw(axis)
        axis.figure.draw_without_rendering()
        assert [label for label in axis.get_yticklabels() if label.get_visible() and label.get_text()]
    assert "share per unit" in figures.coverage(found()).caption


def limits(panel: Panel) -> tuple[float, float]:
    axis = Canvas().subplots()
    panel.draw(axis)
    return axis.get_ylim()


def test_a_panel_of_the_loop_covers_every_loop_that_converges_and_the_true_delay():
    evaluation = found()
    far, lost = replace(evaluation.loops[FNO]), replace(evaluation.loops[DEEPONET])
    far.X[3, 0], far.D_hat[5], lost.X[3:, 0] = 7.0, 2.9, 50.0
    loops = evaluation.loops | {FNO: far, DEEPONET: lost}
    states = evaluation.plant.states
    config = evaluation.config.model_copy(update={"D": 0.2})
    panels = figures.figure1(replace(evaluation, loops=loops, config=config)).panels
    low, high = limits(panels[0])
    assert 7 < high < 20  # the lost loop's 50 leave the picture
    low, high = limits(panels[len(states) + 1])
    assert low < 0.2 and high > 2.9
    near = replace(lost, X=np.where(lost.X == 50.0, 12.0, lost.X))  # a cycle, say: it stays in the picture
    panels = figures.figure1(replace(evaluation, loops=loops | {DEEPONET: near}, config=config)).panels
    assert limits(panels[0])[1] > 12.0


def test_only_the_papers_plant_has_its_figure_and_axes_have_units():
    paper, arm = figures.figure1(found()), figures.figure1(found("planar_arm2"))
    assert "[DAPF, Fig. 1]" in paper.caption and "Fig. 1" not in arm.caption
    assert [panel.title for panel in arm.panels[:5:2]] == ["θ_{1} (rad)", "ω_{1} (rad/s)", "τ_{1} (N m)"]
    cart = plants.resolve("cart_pole")
    assert set(cart.units) == {*cart.states, *cart.inputs}


def test_titles_say_versus():
    for kind in KINDS:
        assert not [panel.title for panel in kind(found()).panels if " over " in panel.title]


def test_the_functional_of_the_proof_is_left_out_where_nothing_adapts():
    evaluation = found()
    assert "W(t) of the proof" in [panel.title for panel in figures.certificate(evaluation).panels]
    frozen = {name: replace(loop, N=np.full_like(loop.N, np.nan)) for name, loop in evaluation.loops.items()}
    panels = figures.certificate(replace(evaluation, loops=frozen)).panels
    assert [panel.title for panel in panels] == ["radius versus ε_{κ}", "distance |X − X*|"]
    for panel in panels:
        ElementTree.fromstring(inline(panel, "p"))


def test_the_line_of_theory_is_left_out_where_nothing_bounds_the_radius():
    bounded, unbounded = figures.certificate(found()), figures.certificate(replace(found(), gain=np.inf))
    assert "110 ε" in bounded.caption and "ε" not in unbounded.caption
    assert len(unbounded.legend) == len(bounded.legend) - 1
    ElementTree.fromstring(inline(unbounded.panels[0], "p"))


def test_the_map_is_left_out_where_the_pipeline_asks_for_none_and_counts_what_is_lost():
    evaluation = found(lost=True)
    alts = {panel.title.split(":")[0]: panel.alt for panel in figures.delays(evaluation).panels}
    assert set(alts) == {"numerical", "no adaptation", "DeepONet", "FNO"}
    assert "3 of 6 cells" in alts["DeepONet"] and "3 others converge with the numerical" in alts["DeepONet"]
    titles = [panel.title for panel in figures.delays(evaluation).panels]
    assert titles == ["numerical: 6 of 6", "no adaptation: 6 of 6", "DeepONet: 3 of 6", "FNO: 6 of 6"]
    assert (
        figures.delays(
            replace(evaluation, models={n: s.model_copy(update={"map": None}) for n, s in evaluation.models.items()})
        )
        is None
    )


def test_each_kind_of_held_out_row_has_a_panel_where_there_are_several():
    evaluation = found()
    figure = figures.kinds(evaluation)
    assert [panel.title for panel in figure.panels] == [
        "nominal rollouts",
        "exploring rollouts",
        "rows with a redrawn D̂",
    ]
    assert (
        "largest" in figure.panels[1].alt and f"{evaluation.kinds['exploring'][FNO].max():.2g}" in figure.panels[1].alt
    )
    assert "held-out samples of nominal rollouts" in figures.errors(evaluation).caption
    exact = {kind: dict.fromkeys(sup, np.zeros(9)) for kind, sup in evaluation.kinds.items()}
    ElementTree.fromstring(inline(figures.kinds(replace(evaluation, kinds=exact)).panels[0], "p"))
    imported = replace(evaluation, kinds={"imported": evaluation.kinds["nominal"]})
    assert figures.kinds(imported) is None and "of the imported data" in figures.box(imported).caption


def test_the_map_of_errors_takes_the_largest_in_each_cell():
    X, sup = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 3.0, 2.0])
    edges, largest = accuracy.worst(X, sup)
    assert (largest[0, 0], largest[-1, -1]) == (1.0, 3.0) and np.isnan(largest).sum() == largest.size - 2
    assert [len(edge) - 1 for edge in edges] == list(largest.shape)


def test_subscripts_of_a_panel_are_spans_below_the_line():
    def draw(axis):
        axis.set(xlabel="ε_{κ} and x_{1} (m)", ylabel="T_{out}")

    root = ElementTree.fromstring(inline(Panel("radius versus ε_{κ}", "ε_{κ} is 1.", draw), "a"))
    texts = {"".join(text.itertext()): text for text in root.iter(f"{SVG}text")}
    spans = [(span.text, span.get("font-size")) for span in texts["εκ and x1 (m)"]]
    assert spans == [("κ", "72%"), (" and x", None), ("1", "72%"), (" (m)", None)]
    assert len(texts["Tout"]) == 1
    assert [root.find(f"{SVG}{tag}").text for tag in ("title", "desc")] == ["radius versus ε_κ", "ε_κ is 1."]


def test_a_panel_on_a_page_follows_its_colours_and_names_only_its_own_parts():
    def draw(axis):
        axis.plot([0.001, 2], [1, 3], color=ROLES["blue"][0], marker="o")

    text = inline(Panel("rise", "It goes up & up.", draw), "a")
    root = ElementTree.fromstring(text)
    assert "var(--blue)" in text and "var(--muted)" in text
    assert not re.findall("#[0-9a-f]{6}", text) and "DejaVu" not in text
    names = {element.get("id") for element in root.iter() if element.get("id")}
    used = {e.get("href", "")[1:] for e in root.iter() if e.get("href")} | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used <= names and all(name.startswith("a-") for name in names)
    assert root.get("role") == "img" and root.get("aria-labelledby") == "a-title a-desc"
    assert [root.find(f"{SVG}{tag}").text for tag in ("title", "desc")] == ["rise", "It goes up & up."]
    assert inline(Panel("rise", "It goes up & up.", draw), "a") == text


@pytest.mark.parametrize("medium", MEDIA)
def test_files_for_papers_have_their_width_and_the_same_bytes_again(tmp_path, medium):
    panel = Panel("error ε over D̂", "A line.", lambda axis: axis.loglog([1e-5, 1], [1e-9, 1]))
    figure = Figure("some", "Some", "Some.", (panel, panel), (LegendEntry("line", LineStyle("ink")),))
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write(figure, tmp_path / name, MEDIA[medium], ("svg", "pdf", "png"))
    for form in ("svg", "pdf", "png"):
        assert (tmp_path / f"a/some.{form}").read_bytes() == (tmp_path / f"b/some.{form}").read_bytes()
    assert f'width="{MEDIA[medium].width * 72:g}pt"' in (tmp_path / "a/some.svg").read_text()


@pytest.mark.filterwarnings("error")
def test_a_loop_that_is_lost_leaves_a_panel_without_a_word(tmp_path):
    t, huge = np.linspace(0, 1, 5), np.array([0, 1, 1.7e308, -1.7e308, np.nan])
    panel = Panel("x", "Lost.", figure_module.curves([(LineStyle("ink"), t, huge)], "t", ylim=(-1, 2)))
    inline(panel, "a")
    write(Figure("lost", "Lost", "Lost.", (panel,)), tmp_path)


def test_threads_that_draw_at_once_leave_each_other_alone(tmp_path):
    """A thread comes into its medium while another one is in the middle of drawing in its own."""
    inside, gone = Event(), Event()

    def draw(axis):
        inside.set()
        gone.wait(0.2)
        axis.plot([0, 1], [0, 1])

    def other():
        inside.wait()
        plain("b")
        gone.set()

    def plain(name):
        write(Figure("some", "Some", "Some.", (Panel("b", "B.", lambda axis: axis.plot([1, 0])),)), room(name))

    def room(name):
        (tmp_path / name).mkdir()
        return tmp_path / name

    thread = Thread(target=other)
    thread.start()
    write(Figure("some", "Some", "Some.", (Panel("a", "A.", draw),)), room("a"), MEDIA["page"])
    thread.join()
    write(Figure("some", "Some", "Some.", (Panel("a", "A.", draw),)), room("again"), MEDIA["page"])
    plain("b again")
    for form in ("svg", "png"):
        assert (tmp_path / f"a/some.{form}").read_bytes() == (tmp_path / f"again/some.{form}").read_bytes()
        assert (tmp_path / f"b/some.{form}").read_bytes() == (tmp_path / f"b again/some.{form}").read_bytes()


@pytest.mark.parametrize(
    "span", [(1.5, 4.4), (0.021, 0.034), (3.1e-5, 4.2e-5), (0.17, 0.21), (0.1172, 0.1201), (1e-9, 1.0), (0.9, 120.0)]
)
def test_ticks_of_a_logarithmic_side_have_labels_of_their_own(span):
    with medium(SCREEN):
        axis = Canvas().subplots()
        axis.plot(span, span)
        log(axis, "y")
        labels = [axis.yaxis.get_major_formatter()(value) for value in axis.get_yticks()]
    assert len(labels) == len(set(labels)) > 1


def test_drawing_leaves_the_settings_of_matplotlib_alone(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    inline(figures.figure1(found()).panels[0], "p")
    assert dict(matplotlib.rcParams) == before


def test_a_training_of_one_epoch_is_seen_as_a_point():
    row = {"epoch": 1, "loss": 0.1, "mse": 0.01, "eps_sup": 0.2}
    figure = figures.learning({FNO: [row], DEEPONET: [row, row | {"epoch": 2}]})
    for panel in figure.panels:
        axis = Canvas().subplots()
        panel.draw(axis)
        assert [line.get_marker() for line in axis.lines] == ["o", "None"]


def test_learning_tells_where_each_network_began_and_ended():
    histories = {FNO: [{"epoch": k, "loss": 1.0 / k, "mse": 0.1 / k, "eps_sup": 2.0 / k} for k in (1, 2, 4)]}
    figure = figures.learning(histories)
    assert [panel.title for panel in figure.panels] == ["training loss", "held-out mean square", "held-out sup error ε"]
    assert figure.panels[2].alt == "held-out sup error ε: FNO 2.00e+00 to 5.00e-01 in 3 epochs."


def test_speed_draws_finite_rows_of_batch_one():
    rows = [timing(name, dx=dx, eps_sup=dx) for name in ("rk4", "euler") for dx in (0.1, 0.01)]
    rows += [timing("fno", "fused", eps_sup=None)]
    figure = figures.speed(rows)
    assert [key.label for key in figure.legend] == ["Euler", "RK4"]
    for panel in figure.panels:
        ElementTree.fromstring(inline(panel, "p"))


@pytest.mark.parametrize("style", [*MEDIA.values(), SCREEN])
def test_no_label_of_an_axis_lies_on_another(style, tmp_path, monkeypatch):
    """Of few and of many predictors, whose names and legend need more and more room."""
    canvases, canvas_of = [], figure_module._canvas
    monkeypatch.setattr(figure_module, "_canvas", lambda *size: canvases.append(canvas_of(*size)) or canvases[-1])
    kinds = [*itertools.product(("euler", "heun", "rk4", "rosenbrock"), ("compiled",))]
    kinds += [*itertools.product(("deeponet", "fno", "gru"), ("fused", "onnx", "torch"))]
    heights = set()
    for count in (3, 8, 9, 10, 13):
        rows = [timing(name, runtime=kind, dx=dx, median_us=1e3 * dx * (k + 1), p999_us=1e4 * (k + 1), eps_sup=dx**k)
                for k, (name, kind) in enumerate(kinds[:count]) for dx in (0.1, 0.01, 0.001)]  # fmt: skip
        if style is SCREEN:
            inline(figures.speed(rows).panels[-1], "a")
        else:
            write(figures.speed(rows), tmp_path, style, ("svg",))
        with medium(style):
            canvases[-1].draw_without_rendering()
            for panel in canvases[-1].axes[:3]:
                heights.add(round(panel.bbox.height / canvases[-1].dpi, 1))
                for axis in (panel.xaxis, panel.yaxis):
                    low, high = sorted(axis.get_view_interval())
                    ticks = zip(axis.get_majorticklocs(), axis.get_ticklabels(), strict=True)
                    boxes = [label.get_window_extent() for at, label in ticks if label.get_text() and low <= at <= high]
                    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2)), (count, axis)
    assert max(heights) - min(heights) < 0.15  # a legend takes no panel its height


def test_speed_leaves_out_of_the_front_what_predicts_nothing():
    rows = [
        timing("deeponet", "fused", eps_sup=0.01),
        timing("euler", eps_sup=1e80),
        timing("euler", dx=0.01, eps_sup=2),
    ]
    rows += [timing("euler", dx=0.001, us=20.0, eps_sup=0.008, matches="deeponet")]
    front, grids, _ = figures.speed(rows).panels
    assert front.alt == "Euler: 2 µs at error 2.0e+00; DeepONet, fused: 2 µs at error 1.0e-02."
    assert "Euler: 2 µs at dx = 0.1, 2 µs at 0.01" in grids.alt


def test_no_line_of_latency_against_error_turns_back_and_every_grid_has_a_mark():
    times = {0.2: (1.0, 0.5), 0.1: (2.0, 1e-3), 0.05: (4.5, 9e-7), 0.02: (8.0, 3e-5), 0.01: (36.0, 1.4e-6)}
    rows = [timing("rk4", dx=dx, us=us, eps_sup=eps) for dx, (us, eps) in times.items()]
    axis = Canvas().subplots()
    figures.speed(rows).panels[0].draw(axis)
    marks, line = axis.lines
    assert sorted(zip(marks.get_ydata(), marks.get_xdata(), strict=True)) == sorted(times.values())
    assert list(line.get_xdata()) == [9e-7, 1e-3, 0.5] and list(line.get_ydata()) == [4.5, 2.0, 1.0]


def test_scenarios_have_a_mark_for_what_is_finite_and_positive():
    does = {"radius": {"median": 0.1, "worst": 0.2, "converged": 0.5, "cases": 4}, "settle_time": 3.0, "far": 1,
            "D_error": 0.02}  # fmt: skip
    wild = does | {"radius": does["radius"] | {"worst": None}, "settle_time": None, "far": 3, "D_error": None}
    rows = [("noise", does, does), ("jump", does, wild)]
    conditions = [Conditions.of({"name": name, "models": {"numerical": a, "fno": b}}, "t") for name, a, b in rows]
    figure = figures.scenarios(plants.resolve("scalar"), conditions)
    assert (
        figure is not None
        and "Loops that overflow, or end farther from rest than a fifth of its size: numerical 2, FNO 4."
        in figure.caption
    )
    assert figure.panels[0].alt == "noise: numerical 0.2, FNO 0.2; jump: numerical 0.2, FNO ∞."
    axis = Canvas().add_subplot()
    for panel in figure.panels:
        axis.clear()
        panel.draw(axis)
        exact, _, network, _ = (line.get_xdata() for line in axis.lines)
        assert np.isfinite(exact).tolist() == [True, True] and np.isfinite(network).tolist() == [True, False]
        assert [label.get_text() for label in axis.get_yticklabels()] == ["noise", "jump"]
    assert figures.scenarios(plants.resolve("scalar"), []) is None


def test_a_scenario_far_left_of_the_others_is_an_arrow_that_does_not_squeeze_them():
    does = {"radius": {"median": 0.1, "worst": 0.2, "converged": 0.5, "cases": 4}, "settle_time": 3.0, "far": 0,
            "D_error": 0.0}  # fmt: skip
    exact = does | {"radius": does["radius"] | {"worst": 1e-12}}
    rows = [("noise 0", exact), ("noise", does)]
    conditions = [Conditions.of({"name": name, "models": {"numerical": one}}, "t") for name, one in rows]
    figure = figures.scenarios(plants.resolve("scalar"), conditions)
    axes = [Canvas().add_subplot() for _ in figure.panels]
    for panel, axis in zip(figure.panels, axes, strict=True):
        panel.draw(axis)
    (mark, arrow), (zero, none) = ([line.get_xdata() for line in axis.lines] for axis in (axes[0], axes[2]))
    assert arrow[0] == pytest.approx(2e-5) and np.isnan(mark[0]) and mark[1] == 0.2 and np.isnan(arrow[1])
    assert np.isnan(zero).all() and np.isnan(none).all()


def test_two_networks_on_one_line_are_both_seen():
    """The dash of the second ends before that of the first, which ends before both start again."""
    first, second = (line_of(PredictorId(name)).dash for name in ("deeponet", "fno"))
    assert second[0] < first[0] < sum(first) == pytest.approx(sum(second))
