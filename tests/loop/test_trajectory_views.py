"""Closed loops in text, as a plot and as a data frame."""

import pickle
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError, MissingError
from npred.lab.config.results import Generated
from npred.loop import trajectory_views
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant


class Escape:
    """X' = X² leaves the numbers at t = 1 / X(0); its input has the name of its state."""

    states, inputs, guess = ("X",), ("X",), (0.0,)
    f = lambda x, u, t, p, M: [x.X**2 + 0 * u.X]
    kappa = lambda x, t, p, M: [0 * x.X]


def loops(**change):
    plant = npred.plant("activator_repressor")
    settings = {"D": 1.0, "D_hat": 1.0, "X0": [0.03, 30.0], "t_end": 0.5, "dt": 0.01} | change
    return npred.simulate(plant, npred.predictor(plant, "heun", nx=11), **settings)


@pytest.fixture(scope="module")
def one():
    return loops()


@pytest.fixture(scope="module")
def batch():
    return loops(D=[[1.0, 1.2, 1.4]], D_hat=[[0.5], [1.0]])


def test_prints_ranges_and_ends(one):
    ends = one.X[-1]
    assert str(one).splitlines() == [
        "Trajectories: 1 loop, 51 times from 0 to 0.5 s",
        f"  x1     {ends[0]:.4g} … 0.03, ends at {ends[0]:.4g}",
        f"  x2     {ends[1]:.4g} … 30, ends at {ends[1]:.4g}",
        f"  U      {one.U.min():.4g} … {one.U.max():.4g}, ends at {one.U[-1, 0]:.4g}",
        "  D_hat  1, ends at 1 s",
    ]
    assert repr(one) == str(one)


def test_says_that_an_estimate_ended_at_its_bound():
    plant = npred.plant("scalar")
    for law in (npred.DelayObserver(bounds=(0.1, 0.8)), npred.DelayAdaptation(5.0, 1.0, (0.1, 0.8))):
        settings = {"D_hat": 0.5, "X0": [1.0], "t_end": 6.0, "dt": 0.01, "adaptation": law}
        run = npred.simulate(plant, npred.predictor(plant, "heun", nx=11), D=[1.2, 0.5], **settings)
        words = "  D_hat ended at its bound in 1 of 2 loops and the delay may lie outside; widen bounds"
        assert str(run).splitlines()[-1] == words
        assert "ended at its bound and the delay may lie outside" in str(replace(run, **one_of(run)))


def one_of(run):
    return {"D_hat": run.D_hat[0], "X": run.X[0], "U": run.U[0], "escaped": run.escaped[0]}


def test_prints_a_batch_as_ranges(batch):
    first, *_, last = str(batch).splitlines()
    assert first == "Trajectories: 6 loops (2, 3), 51 times from 0 to 0.5 s"
    assert last == "  D_hat  0.5 … 1, ends at 0.5 … 1 s"
    assert all(len(line) <= 80 for line in str(batch).splitlines())


@pytest.mark.filterwarnings("error")
def test_says_which_loops_escape_and_tells_two_of_one_name_apart():
    plant = Plant("escape", Escape)
    heun, settings = npred.predictor(plant, "heun", 11), {"D": 0.1, "D_hat": 0.1, "t_end": 1.0, "dt": 0.001}
    both = npred.simulate(plant, heun, X0=[[0.1], [2.0]], **settings)
    lines = str(both).splitlines()
    assert lines[0] == "Trajectories: 2 loops, 1001 times from 0 to 1 s"
    assert lines[1].startswith("  X.X ") and lines[2].startswith("  U.X ")
    assert lines[-1] == f"  1 of 2 overflow, first at control step {both.escaped[1]}"
    one = npred.simulate(plant, heun, X0=[2.0], **settings)
    assert str(one).splitlines()[1].endswith("ends at nan") and "it overflows, first" in str(one)


def test_parts_and_joined_batches_keep_the_names(batch):
    flat = loops(D=[1.0, 1.2])
    joined = Trajectories.joined([flat.part(slice(0, 1)), flat.part(slice(1, 2))])
    assert joined.states == ("x1", "x2") and joined.inputs == ("U",)
    assert str(joined) == str(flat)


def test_names_are_numbers_where_there_are_none_and_must_fit(one):
    unnamed = pickle.loads(pickle.dumps(one))
    object.__setattr__(unnamed, "states", ())
    assert [name for name, _ in trajectory_views.series(unnamed)] == ["X1", "X2", "U", "D_hat"]
    object.__setattr__(unnamed, "states", ("a",))
    with pytest.raises(ConfigError, match="expected 2 names for X, got a; name each"):
        str(unnamed)


def test_plots_a_panel_a_series_and_a_line_a_loop(batch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    with pyplot.rc_context({"backend": "agg"}):
        axes = batch.plot(D=[1.0, 1.2, 1.0])
        assert [panel.get_ylabel() for panel in axes] == [
            r"x$_{\mathrm{1}}$",
            r"x$_{\mathrm{2}}$",
            "U",
            r"$\hat{D}$ (s)",
        ]
        assert [len(panel.lines) for panel in axes] == [6, 6, 6, 6 + 2]
        np.testing.assert_array_equal(axes[1].lines[4].get_ydata(), batch.X[1, 1, :, 1])
        assert axes[-1].get_xlabel() == "t (s)"
        pyplot.close(axes[0].figure)


class Tank:
    """A plant with names for axes."""

    states, inputs, guess = ("h_a", "T"), ("q",), (1.0, 1.0)
    labels, units, time_unit = {"h_a": "level h_{a}"}, {"h_a": "m", "q": "m^3/min"}, "min"
    f = lambda x, u, t, p, M: [u.q - x.h_a, -x.T]
    kappa = lambda x, t, p, M: [2 - x.h_a]


def test_a_plot_has_the_labels_and_units_that_the_plant_declares():
    from matplotlib import pyplot

    plant = Plant("tank", Tank)
    loop = npred.simulate(plant, npred.predictor(plant, "heun", 5), D=0.1, D_hat=0.1, X0=[1, 1], t_end=0.2, dt=0.01)
    with pyplot.rc_context({"backend": "agg"}):
        axes = loop.plot()
        axes[0].figure.canvas.draw()  # mathematics that matplotlib cannot read raises here
        labels = [panel.get_ylabel() for panel in axes]
        pyplot.close(axes[0].figure)
    assert labels == ["level h$_{\\mathrm{a}}$ (m)", "T", "q (m$^{3}$/min)", "$\\hat{D}$ (min)"]
    assert axes[-1].get_xlabel() == "t (min)"


def test_a_data_frame_has_a_row_a_time(one):
    frame = one.to_dataframe()
    assert list(frame.columns) == ["x1", "x2", "U", "D_hat"] and frame.index.name == "t"
    np.testing.assert_array_equal(frame.index, one.t)
    np.testing.assert_array_equal(frame[["x1", "x2"]], one.X)


def test_a_data_frame_of_a_batch_is_indexed_by_loop_and_time(batch):
    frame = batch.to_dataframe()
    assert frame.index.names == ["loop0", "loop1", "t"] and len(frame) == 6 * 51
    np.testing.assert_array_equal(frame.loc[(1, 2), "x2"], batch.X[1, 2, :, 1])
    assert loops(D=[1.0, 1.2]).to_dataframe().index.names == ["loop", "t"]


def test_without_pandas_a_data_frame_says_what_to_install(one, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingError, match="expected the package pandas, found none; pip install pandas"):
        one.to_dataframe()


def test_neither_matplotlib_nor_pandas_comes_with_a_loop():
    program = "import sys, npred; npred.simulate; print([m for m in ('matplotlib', 'pandas') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_loops_with_labels_share_a_figure_and_keep_their_colour_over_the_panels(one, batch):
    from matplotlib import pyplot

    with pyplot.rc_context({"backend": "agg"}):
        axes = one.plot(label="first")
        assert batch.plot(ax=axes, label="six more")[0] is axes[0]
        colours = [[line.get_color() for line in panel.lines] for panel in axes]
        assert colours == [["C0", *["C1"] * 6]] * 4
        assert [text.get_text() for text in axes[0].get_legend().get_texts()] == ["first", "six more"]
        pyplot.close(axes[0].figure)


def test_a_plot_takes_axes_of_any_arrangement_and_refuses_too_few(one):
    from matplotlib import pyplot

    with pyplot.rc_context({"backend": "agg"}):
        figure, axes = pyplot.subplots(2, 2)
        assert list(one.plot(ax=axes)) == list(axes.flat) and axes[0, 0].get_legend() is None
        with pytest.raises(ConfigError, match=r"expected 4 matplotlib axes, for x1, x2, U, D_hat, got 2 axes"):
            one.plot(ax=figure.subplots(2, 1))
        with pytest.raises(ConfigError, match=r"expected 4 matplotlib axes, .* got 'ax'"):
            one.plot(ax="ax")
        pyplot.close(figure)


@pytest.mark.filterwarnings("error")
def test_a_lost_loop_leaves_the_picture_and_the_others_are_shown_whole():
    from matplotlib import pyplot

    plant = npred.plant("cart_pole")
    heun = npred.predictor(plant, "heun", nx=31)
    settings = {"D": 0.3, "X0": [0.3, 0, 0.1, 0], "t_end": 20, "input_bounds": [(-1e300, 1e300)]}
    lost, kept = (npred.simulate(plant, heun, D_hat=D_hat, **settings) for D_hat in (0, 0.3))
    assert lost.escaped > 0 and np.nanmax(np.abs(lost.X)) > 1e50 and kept.escaped < 0
    with pyplot.rc_context({"backend": "agg"}):
        for first, second in ((lost, kept), (kept, lost)):
            axes = first.plot(label="first")
            second.plot(ax=axes, label="second")
            for panel, (_, values) in zip(axes[:-1], trajectory_views.series(kept), strict=False):
                (low, high), height = panel.get_ylim(), np.ptp(values)
                assert low < values.min() and values.max() < high and high - low < 4 * height
            axes[0].figure.canvas.draw()
        alone = lost.plot()
        alone[0].figure.canvas.draw()
        for panel, X in zip(alone, lost.X.T, strict=False):
            assert panel.get_ylim()[1] < 1e5 and panel.get_ylim()[1] > np.nanmax(X[:100])
        far = npred.simulate(
            plant, heun, D_hat=0, **settings | {"t_end": 200}
        )  # gone before a tenth of the time is over
        far.plot()[0].figure.canvas.draw()
        assert not trajectory_views._lost(loops(t_end=2.0)).any()
        pyplot.close("all")


def test_a_plot_has_the_signals_and_the_size_that_are_asked_for(one):
    from matplotlib import pyplot

    with pyplot.rc_context({"backend": "agg"}):
        axes = one.plot(signals=("U", "x2"), size=(5, 4))
        assert axes[0].get_ylabel() == "U" and len(axes) == 2
        np.testing.assert_array_equal(axes[1].lines[0].get_ydata(), one.X[:, 1])
        assert tuple(axes[0].figure.get_size_inches()) == (5, 4)
        axes = one.plot(signals="X", size="article", label="first")
        for label in ("second", "a loop with a long name"):
            one.plot(ax=axes, label=label)
        assert [len(panel.lines) for panel in axes] == [3, 3] and axes[0].figure.get_figwidth() == 3.5
        axes[0].figure.draw_without_rendering()
        assert axes[0].get_legend().get_window_extent().x1 <= axes[0].figure.bbox.x1
        texts = [
            *axes[0].get_legend().get_texts(),
            *axes[1].get_xticklabels(),
            axes[1].xaxis.label,
            axes[0].yaxis.label,
        ]
        assert {text.get_fontsize() for text in texts} == {7}
        with pytest.raises(ConfigError, match="signals: expected one of X, U, x1, x2, D_hat, got 'x3'; did you mean"):
            one.plot(signals=("x3",))
        with pytest.raises(ConfigError, match=r"signals: expected at least one of .*, got none"):
            one.plot(signals=())
        for size in ("paper", (3,), (0, 2)):
            with pytest.raises(ConfigError, match='size: expected "article", or width and height in inches, got '):
                one.plot(size=size)
        with pytest.raises(ConfigError, match="size: expected none beside ax"):
            one.plot(ax=axes, signals="X", size="article")
        pyplot.close("all")


def test_a_notebook_shows_text_and_plot_of_a_few_loops_and_the_text_of_many(one, batch):
    from matplotlib import pyplot

    before = pyplot.get_fignums()
    page = batch._repr_html_()
    assert pyplot.get_fignums() == before  # else a notebook shows the figure twice
    text, svg = page.split("</pre>")
    assert "D_hat  0.5 … 1" in text
    root = ElementTree.fromstring(svg)
    assert "U" in {element.text for element in root.iter(f"{root.tag[:-3]}text")}
    assert "<svg" not in replace(batch, escaped=np.full(21, -1))._repr_html_()
    assert len(one._repr_html_()) < 50_000


def test_a_notebook_shows_names_as_text():
    plant = Plant("tank", Tank)
    assert "&lt;Plant tank: " in plant._repr_html_() and "<Plant" not in plant._repr_html_()
    assert "nx = 7" in npred.predictor(plant, "rk4", 7)._repr_html_()
    assert "samples: 3" in Generated(samples=3, rollouts=1, held_out=[0], nx=5)._repr_html_()
