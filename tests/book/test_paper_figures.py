"""The paper's figures: each of their curves is a run."""

from offairl_lite.experiments import configure
from paper_figures import FIGURES, record


def test_a_record_is_where_the_command_line_puts_it_but_for_the_experts():
    assert record("maze-imitation", "full") == "maze-imitation-full"
    assert record("maze-dac/td3", "demo") == "maze-dac-demo/td3"
    assert record("experts/Hopper-td3", "full") == "experts/Hopper-td3"
    assert record("experts/Hopper-td3", "demo") == "experts-demo/Hopper-td3"
    assert record("experts/PointMazeLeft-sac-learned", "demo") == "maze-expert-left-demo"


def test_every_curve_of_the_paper_is_a_run():
    panels = [panel for figure in FIGURES.values() for panel in figure.items()]
    for title, curves in panels:
        tasks = {
            configure(run, scale).env_id for run in curves.values() for scale in ("demo", "full")
        }
        named = {task.split("/")[-1].split("-")[0] for task in tasks}
        assert named in ({title.split(",")[0]}, {"PointMazeRight"}) or named == {
            "DisabledAnt",
            "DisabledAntReleased",
        }
        assert len(set(curves.values())) == len(curves)
    # Besides the environments (4) and the actor (1), the paper has 30 panels; two are added,
    # and four are drawn for the first settings, too.
    again = FIGURES["off-policy AIRL and DAC, first settings"]
    assert len(panels) - len(again) == 30 + 2
