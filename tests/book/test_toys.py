"""The interactive figures: their numbers are the package's, and hands and keys can use them."""

import base64
import itertools
import json
import math
import re
import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import nbformat
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from scipy.special import log_softmax
from scipy.stats import norm
from test_browser import BROWSERS, FLAGS, LOCAL, MAC, shutil, sync_api

import grid_worlds
from figures import toys
from offairl_lite import plain, tabular
from offairl_lite.core.policies import product_of_gaussians
from offairl_lite.plain import log_density
from offairl_lite.tabular import MDP, empirical_occupancy, occupancy, soft_value_iteration

BOOK = Path(toys.__file__).parents[1]
PAGE = """<!doctype html><html data-theme={theme}><meta charset=utf-8>
<meta name=viewport content="width=device-width"><body>{body}"""
LIST = partial(json.dumps, default=np.ndarray.tolist)


@pytest.fixture(scope="module")
def browser():
    executable = next(filter(None, map(shutil.which, [*BROWSERS, MAC])), None)
    if executable is None:
        pytest.skip("no Chromium or Chrome found: `make system` installs one on Debian and Ubuntu")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=executable, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, tmp_path):
    """Open a page with toys; it must load nothing and make no error."""
    views, wrong = [], []

    def visit(*names, theme="light", width=900, **options):
        path = tmp_path / f"{len(views)}.html"
        path.write_text(PAGE.format(theme=theme, body="".join(map(toys.page, names))))
        options.setdefault("reduced_motion", "reduce")
        view = browser.new_page(viewport={"width": width, "height": 1000}, **options)
        view.on("console", lambda m: m.type == "error" and wrong.append(m.text))
        view.on("pageerror", lambda error: wrong.append(f"{error}"))
        view.on("request", lambda r: LOCAL(r.url) or wrong.append(r.url))
        view.goto(path.as_uri())
        views.append(view)
        return view

    yield visit
    for view in views:
        view.close()
    assert wrong == []


def words(place):
    """What stands there, with plain spaces."""
    return " ".join(place.inner_text().split())


def said(view):
    """What a toy announces when it has learned."""
    view.wait_for_function("!toys.all[0].state().learning")
    return words(view.locator(".toy-says").first)


@pytest.fixture(scope="module")
def compute(browser):
    """Evaluate JavaScript where all toys are known."""
    view = browser.new_page()
    view.set_content(PAGE.format(theme="light", body="".join(map(toys.page, toys.TOYS))))
    yield lambda code: view.evaluate(f"(() => {{const {{mazes}} = toys; {code}}})()")
    view.close()


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize("cells", [12, 20])
def test_the_mazes_are_the_packages(compute, cells, side):
    maze = tabular.maze(cells, side)
    theirs = compute(f"""const {{wall, start, goal, reward}} = mazes.book({cells}, "{side}");
      return {{to: [...mazes.build({cells}, wall)], start, goal, reward: [...reward]}};""")
    assert theirs["to"] == maze.mdp.transition.indices.tolist()
    assert theirs["start"] == maze.mdp.initial.argmax()
    assert theirs["goal"] == maze.reward.argmax()
    np.testing.assert_allclose(theirs["reward"], maze.reward, atol=1e-12)


@pytest.mark.parametrize("alpha", [0.05, 1.0])
@pytest.mark.parametrize("shape", [(144,), (144, 5)])
def test_policies_and_visits_are_the_packages(compute, alpha, shape):
    maze = tabular.maze(12, "Right")
    reward = np.random.default_rng(0).normal(size=shape)
    theirs = compute(f"""const to = mazes.build(12, mazes.book(12, "Right").wall);
      const {{policy, value}} = mazes.solve(to, {LIST(reward.ravel())}, {alpha}, 0.97);
      const d = mazes.visits(to, policy, {LIST(maze.mdp.initial)}, 0.97);
      return [[...policy], [...value], [...d],
        mazes.score(d, policy, {LIST(maze.reward)})];""")
    solution = soft_value_iteration(maze.mdp, reward, alpha)
    visits = occupancy(maze.mdp, solution.policy)
    np.testing.assert_allclose(theirs[0], solution.policy.ravel(), atol=1e-6)
    np.testing.assert_allclose(theirs[1], solution.value, atol=1e-6)
    np.testing.assert_allclose(theirs[2], visits.sum(1), atol=1e-6)
    assert theirs[3] == pytest.approx(visits.sum(1) @ maze.reward, abs=1e-6)


@pytest.fixture(scope="module")
def given(compute, tmp_path_factory):
    """A file as the toy writes it, with the three demonstrations that it offers."""
    path = tmp_path_factory.mktemp("drawn") / "demonstrations.json"
    content = compute("""return {cells: 20, wall: mazes.book(20, "Left").wall,
      demonstrations: toys.walls.given()}""")
    path.write_text(json.dumps(content))
    return path


def test_what_was_drawn_can_be_read(given):
    maze = toys.maze(given)
    assert (maze.transition != tabular.maze(20, "Left").mdp.transition).nnz == 0
    drawn = toys.drawn(given)
    assert drawn.states.shape == (3, 401)
    assert empirical_occupancy(maze, drawn).sum() == pytest.approx(1 / 0.03)
    with pytest.raises(ValueError, match="a demonstration has 23 actions"):
        toys.drawn(given, length=22)


def test_learning_climbs_the_likelihood(compute, given):
    """Its steps are the gradient of chapter 1, spread over neighbours."""
    mdp, drawn = toys.maze(given), toys.drawn(given)
    seen = empirical_occupancy(mdp, drawn)
    history = compute("""const lesson = toys.walls.learning(
        mazes.build(20, mazes.book(20, "Left").wall), toys.walls.given());
      return [...Array(20)].map(() => lesson.next().value)
        .map(({reward, difference}) => [[...reward], [...difference]]);""")
    likelihoods = []
    for reward, difference in history:
        likelihood, gradient = tabular.log_likelihood(mdp, np.array(reward), seen)
        likelihoods.append(likelihood)
        np.testing.assert_allclose(difference, gradient.sum(1), atol=1e-3)
    assert (np.diff(likelihoods) > 0).all()
    steps = np.diff([reward for reward, _ in history], axis=0)
    bumps = (
        0.05
        * 2
        * np.pi
        * gaussian_filter(
            np.reshape([d for _, d in history[:-1]], (-1, 20, 20)),
            (0, 1, 1),
            mode="constant",
            truncate=9,
        )
    )
    np.testing.assert_allclose(steps, bumps.reshape(-1, 400), atol=1e-3)


def squares(view):
    """Turn a column and a row, counted from the lower left, into a place on the screen."""
    box = view.locator(".toy canvas").first.bounding_box()
    size = (box["width"] - 14) / 20
    return lambda column, row: (
        box["x"] + 7 + size * column,
        box["y"] + box["width"] - 7 - size * row,
    )


def drag(view, *places):
    view.mouse.move(*places[0])
    view.mouse.down()
    for place in places[1:]:
        view.mouse.move(*place, steps=8)
    view.mouse.up()


def test_the_wall_is_dragged_with_the_mouse(opened):
    view = opened("walls", reduced_motion="no-preference")
    assert said(view) == "Copy: arrives. Reward: arrives. Now drag the wall."
    at = squares(view)
    drag(view, at(7, 11), at(16, 11))
    assert said(view) == "Copy: stuck. Reward: arrives."
    drag(view, at(14.5, 11), at(5.5, 11))
    assert said(view) == "Copy: arrives. Reward: arrives. Now drag the wall."


def test_the_wall_is_moved_with_keys(opened):
    view = opened("walls")
    view.keyboard.press("Tab")
    outline = "getComputedStyle(document.activeElement).outlineStyle"
    assert view.evaluate(f"[document.activeElement.tagName, {outline}]") == ["CANVAS", "solid"]
    for _ in range(9):
        view.keyboard.press("ArrowRight")
    assert said(view) == "Copy: stuck. Reward: arrives."
    view.keyboard.press("ArrowDown")
    assert view.evaluate("toys.all[0].state().wall.row") == 10


def test_demonstrations_are_drawn_with_a_finger_and_downloaded(opened, tmp_path):
    view = opened("walls", width=390, has_touch=True, is_mobile=True, device_scale_factor=3)
    view.get_by_role("button", name="Draw your own").tap()
    at, hand = squares(view), view.context.new_cdp_session(view)
    places = [at(3.5, 3.5), at(17.5, 3.5), at(17.5, 13.5), at(4.5, 16.5)]
    scrolled = view.evaluate("scrollY")
    for kind, place in zip(["Start", "Move", "Move", "Move", "End"], [*places, None], strict=True):
        points = [{"x": place[0], "y": place[1]}] if place else []
        hand.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    assert view.evaluate("scrollY") == scrolled
    assert "Reward: arrives" in said(view)
    with view.expect_download() as download:
        view.get_by_role("button", name="Download").tap()
    path = tmp_path / "drawn.json"
    download.value.save_as(path)
    maze, drawn = toys.maze(path), toys.drawn(path)
    assert len(drawn.states) == 1
    assert drawn.states[0, [0, -1]].tolist() == [3 + 20 * 3, 4 + 20 * 16]
    assert maze.initial.argmax() == 3 + 20 * 3
    assert empirical_occupancy(maze, drawn)[4 + 20 * 16].sum() > 9


def test_a_toy_says_the_step_that_its_slider_shows(opened):
    view = opened("walls", "rewards", reduced_motion="no-preference")
    told = view.evaluate("""async () => {
      const told = [];
      for (let k = 0; k < 40; k++) {
        await new Promise(requestAnimationFrame);
        for (const root of document.querySelectorAll('.toy')) {
          const says = root.querySelector('.toy-says').textContent.match(/fter (\\d+) steps/);
          if (says) told.push([+says[1], +root.querySelector('input[type=range]').value]);
        }
      }
      return told;
    }""")
    assert len(told) > 20
    assert all(said == shown for said, shown in told)


def test_demonstrations_are_drawn_with_keys(opened):
    view = opened("walls")
    canvas = view.locator(".toy canvas").first
    canvas.press("ArrowRight")
    assert view.evaluate("toys.all[0].state().wall.from - toys.all[0].state().home.from") == 1
    view.get_by_role("button", name="Draw your own").click()
    assert view.evaluate("toys.all[0].state().wall.from - toys.all[0].state().home.from") == 0
    canvas.focus()
    keys = ["Space", *["ArrowLeft"] * 6, "Space"]
    for key in keys:
        view.keyboard.press(key)
    (one,) = view.evaluate("toys.all[0].state().demos")
    assert one["actions"] == [3] * 6
    assert said(view).startswith("Copy: arrives. Reward: arrives")


def test_a_toy_has_a_still_for_paper_and_without_scripts(opened):
    view = opened(*toys.TOYS)
    shown = """[...document.querySelectorAll('.toy')]
      .map(toy => [...toy.children].filter(e => e.offsetHeight).map(e => e.tagName))"""
    assert view.evaluate(shown) == [["DIV", "P", "DIV"]] * len(toys.TOYS)
    view.emulate_media(media="print")
    assert view.evaluate(shown) == [["IMG"]] * len(toys.TOYS)
    view = opened(*toys.TOYS, java_script_enabled=False)
    stills = view.get_by_role("img").all()
    assert len(stills) == len(toys.TOYS)
    assert min(still.bounding_box()["height"] for still in stills) > 100


def test_whatever_a_finger_has_to_hit_is_large_enough(opened):
    view = opened(*toys.TOYS, width=390, has_touch=True, is_mobile=True)
    sizes = view.evaluate("""[...document.querySelectorAll(
        '.toy button, .toy .toy-choice label, .toy input[type=range]')]
      .map((e) => [e.offsetWidth, e.offsetHeight])""")
    assert len(sizes) > 50
    assert np.min(sizes) >= 40


def test_toys_fit_a_phone_and_a_dark_page(opened):
    light, dark = (opened(*toys.TOYS, theme=theme, width=390) for theme in ("light", "dark"))
    paper = "getComputedStyle(document.querySelector('.toy')).backgroundColor"
    brightness = [sum(map(int, re.findall(r"\d+", v.evaluate(paper))[:3])) for v in (light, dark)]
    assert brightness[0] > 700 > 200 > brightness[1]
    assert light.evaluate("document.documentElement.scrollWidth") == 390
    dark.evaluate("document.documentElement.dataset.theme = 'light'")
    dark.wait_for_function(f"{paper} === '{light.evaluate(paper)}'")
    lab = "delete document.documentElement.dataset.theme; document.body.dataset.jpThemeLight = "
    dark.evaluate(lab + "'false'")
    dark.wait_for_function(f"{paper} !== '{light.evaluate(paper)}'")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_low_reward_is_dark_on_every_page(opened, theme):
    view = opened("drawn_maze", theme=theme)
    view.wait_for_timeout(300)
    pixel = """([across, up]) => {
      const canvas = document.querySelector(".toy canvas"), {width, height} = canvas;
      const place = [Math.round(across * width), Math.round((1 - up) * height), 1, 1];
      return [...canvas.getContext("2d").getImageData(...place).data].slice(0, 3);
    }"""
    corner, goal = (sum(view.evaluate(pixel, at)) for at in ([0.04, 0.04], [0.53, 0.91]))
    assert corner < 200 < 400 < goal


def test_two_toys_on_a_page_are_each_started_once(opened):
    view = opened("walls", "walls")
    assert view.evaluate("toys.all.length") == 2
    assert view.locator(".toy-stage").count() == 2


def test_a_toy_that_does_not_exist_is_named():
    with pytest.raises(ValueError, match="there is no toy 'wals'; choose one of walls"):
        toys.show("wals")


def cells(page, *ids, **names):
    """Run cells of a chapter that use these names; return those that they make, too."""
    names |= {"np": np, "tabular": tabular}
    for cell in nbformat.read(BOOK / page, as_version=4).cells:
        if cell.id in ids:
            exec(cell.source, names)
    return names


def test_the_reward_of_the_move_falls_off_the_cliff_and_that_of_the_place_does_not(compute):
    """Each is learned as in chapter 1: what the toy plans with it returns what the package does."""
    rewards = compute("""const {MAZES, alpha, gamma, expert, planned} = toys.rewards;
      const {seen, initial} = expert();
      const at = (ofState, k) => {
        const lesson = mazes.maxent(MAZES[0].to, seen, initial, alpha, gamma, ofState);
        let reward;
        for (let i = 0; i <= k; i++) reward = lesson.next().value;
        return {reward: [...reward], values: MAZES.map((m) => planned(m, reward, alpha).value)};
      };
      return {place: at(true, 100), early: at(false, 50), late: at(false, 150)};""")
    returns = {}
    for name, learned in rewards.items():
        reward = np.array(learned["reward"])
        reward = reward if name == "place" else reward.reshape(400, 5)
        returns[name] = []
        for side in ("Left", "Right"):
            maze = tabular.maze(20, side)
            policy = soft_value_iteration(maze.mdp, reward, 0.05).policy
            returns[name].append(tabular.policy_return(maze.mdp, policy, maze.reward))
        assert learned["values"] == pytest.approx(returns[name], abs=1e-6)
    assert min(first for first, _ in returns.values()) > -5.2
    assert returns["place"][1] > -5.2
    assert returns["early"][1] > -6
    assert returns["late"][1] < -9


def test_the_shaping_changes_no_policy_of_the_first_maze(compute):
    noise = compute("return [...toys.rewards.shaping()]")
    maze, shaped = tabular.maze(20, "Left"), np.reshape(noise, (400, 5))
    assert shaped.std() > 0.1
    before = soft_value_iteration(maze.mdp, maze.reward, 0.05).policy
    after = soft_value_iteration(maze.mdp, maze.reward[:, None] + shaped, 0.05).policy
    np.testing.assert_allclose(after, before, atol=1e-8)


@pytest.mark.parametrize("who", ["A", "B"])
def test_the_corridor_is_that_of_chapter_2(compute, who):
    ids = "2b726df3", "1c4374cd", "8d6e1d18-helpers", "8d6e1d18-distance", "4816d6ec", "091c50b3"
    chapter = cells("02_gail_and_dac.ipynb", *ids)
    ends = compute(f"""const {{REWARDS, EXPERTS, round, gone, occupancy}} = toys.corridor;
      return Object.values(REWARDS).map(({{of}}) => {{
        let policy = Array(7).fill(0.5);
        for (let k = 0; k < 150; k++) ({{policy}} = round(EXPERTS.{who}, policy, of));
        return {{policy, gone: gone(policy), time: occupancy(policy)}};
      }});""")
    for end, reward in zip(ends, chapter["REWARDS"].values(), strict=True):
        policy = chapter["play"](chapter["EXPERTS"][who], reward)
        np.testing.assert_allclose(end["policy"], policy[:, 1], atol=1e-6)
        np.testing.assert_allclose(end["time"], chapter["occupancy"](policy), atol=1e-6)
        assert end["gone"] == pytest.approx(chapter["gone"](policy), abs=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_game_is_that_of_chapter_3(compute, sign):
    chapter = {"cells": 12, "replace": replace, "occupancy": occupancy, "log_softmax": log_softmax}
    chapter |= {"soft_value_iteration": soft_value_iteration}
    chapter = cells("03_airl_discriminator.ipynb", "3830ed9b", "90456e37", **chapter)
    story = compute(f"""const {{expert, compare, round}} = toys.game, theirs = expert();
      let policy = new Float64Array(720).fill(0.2);
      return [...Array(9)].map(() => {{
        const {{distance, error}} = compare(theirs, policy);
        policy = round(theirs, policy, 0.2, {sign});
        return [distance, error];
      }});""")
    history, _ = chapter["play"](np.log(chapter["uniform"]), 0.2, 9, sign)
    np.testing.assert_allclose(story, history, rtol=1e-5)


def test_products_are_the_packages(compute):
    rng = np.random.default_rng(0)
    mean, std = rng.normal(size=(2, 2)), rng.uniform(0.1, 1, (2, 2))
    weight = rng.uniform(0.1, 1, 2)
    primitives = [{"mean": m, "std": s} for m, s in zip(mean, std, strict=True)]
    theirs = compute(f"""const primitives = {LIST(primitives)};
      return [toys.products.compose(primitives, {LIST(weight)}),
        toys.products.mixture(primitives, {LIST(weight)})([0.3, -0.2]),
        toys.products.product(primitives, {LIST(weight)})([0.3, -0.2])];""")
    tensors = [torch.as_tensor(x) for x in (mean, np.log(std), weight)]
    for ours, key in zip(product_of_gaussians(*tensors), ("mean", "std"), strict=True):
        ours = ours if key == "mean" else ours.exp()
        np.testing.assert_allclose([part[key] for part in theirs[0]], ours, atol=1e-9)
    each = norm.pdf([0.3, -0.2], mean, std).prod(1)
    assert theirs[1] == pytest.approx(each @ weight / weight.sum())
    parts = [(part["mean"], part["std"]) for part in theirs[0]]
    product = [norm.pdf(x, *part) for x, part in zip([0.3, -0.2], parts, strict=True)]
    assert theirs[2] == pytest.approx(np.prod(product))


def test_the_squashed_density_is_that_of_the_plain_program(compute):
    a = np.linspace(-0.99, 0.99, 7)
    theirs = compute(f"""const {{density, area}} = toys.squash;
      return [{LIST(a)}.map((x) => density(x, 0.5, 1.2)), area(0.5, 1.2)];""")
    given = torch.tensor([[0.5], [np.log(1.2)]])
    ours = log_density(torch.as_tensor(np.arctanh(a))[:, None], *given).exp()
    np.testing.assert_allclose(theirs[0], ours, rtol=1e-6)
    slope = norm(0.5, 1.2).expect(lambda u: 1 - np.tanh(u) ** 2)
    assert theirs[1] == pytest.approx(slope, abs=1e-6)


def test_lives_are_those_of_chapter_7(compute):
    chapter = cells("07_absorbing_states.ipynb", "b889d278", "c104095d")
    theirs = compute(f"""const gammas = {LIST(chapter["gammas"])};
      const shifts = {LIST(chapter["shifts"])};
      return [0, 1].map((own) => shifts.map((c) =>
        gammas.map((g) => toys.life.fate(c, g, own * c))));""")
    assert theirs == [chapter["nothing"], chapter["itself"]]


def test_the_rewards_of_the_maze_are_the_recorded_ones_and_plans_are_the_packages(compute):
    tables = runpy.run_path(str(toys.FOLDER / "tables.py"))
    table = compute("return toys.tables")
    np.testing.assert_allclose(table["rewards"], tables["rewards"](), atol=1)
    maze = tabular.maze(table["cells"], "Right")
    value = compute("""const {cells, rewards} = toys.tables;
      return [...toys.drawn_maze.planned(mazes.book(cells, "Right").wall, rewards[2]).value];""")
    reward = np.array(table["rewards"][2]) / 999
    expected = soft_value_iteration(maze.mdp, reward, 0.0).value
    np.testing.assert_allclose(value, expected, atol=1e-6)


def test_a_share_of_the_actions_can_fail(compute):
    maze = tabular.maze(12, "Left", slip=0.3)
    reward = np.random.default_rng(0).normal(size=(144, 5))
    theirs = compute(f"""const to = mazes.build(12, mazes.book(12, "Left").wall);
      return [...mazes.solve(to, {LIST(reward.ravel())}, 0.05, 0.97, {{slip: 0.3}}).policy];""")
    expected = soft_value_iteration(maze.mdp, reward, 0.05).policy
    np.testing.assert_allclose(theirs, expected.ravel(), atol=1e-9)


def test_the_pendulum_is_gymnasiums(compute):
    """Every step and its reward, also where torque and speed reach their limits."""
    torques = np.random.default_rng(0).uniform(-3, 3, 300)
    torques[100:200] = 3
    theirs = compute(f"""let state = [3, -7.5];
      return {LIST(torques)}.map((torque) => {{
        const next = toys.pendulum.step(state, torque);
        state = next.state;
        return [...state, next.reward];
      }});""")
    env = gymnasium.make("Pendulum-v1").unwrapped
    env.reset(seed=0)
    env.state, ours = np.array([3, -7.5]), []
    for torque in torques:
        reward = env.step(np.array([torque]))[1]
        ours.append([*env.state, reward])
    assert np.abs(ours, dtype=float)[:, 1].max() == 8
    np.testing.assert_allclose(theirs, ours, atol=1e-9)


@pytest.fixture(scope="module")
def pendulum():
    """Actor and critics, as the file has them."""
    text = (toys.FOLDER / "networks.js").read_text("utf-8")
    written = json.loads(text[text.index("{") : text.rindex(";")])
    sac = plain.SAC(3, 1, torch.Generator())
    nets = [sac.actor.net, *sac.critic.nets]
    for net, kept in zip(nets, [written["actor"], *written["critics"]], strict=True):
        linear = [layer for layer in net.double() if isinstance(layer, torch.nn.Linear)]
        for layer, part in zip(linear, kept, strict=True):
            units = np.frombuffer(base64.b64decode(part["numbers"]), "<i2").astype(float)
            weight, bias = np.split(part["scale"] * units, [layer.weight.numel()])
            layer.weight.data = torch.tensor(weight).view_as(layer.weight)
            layer.bias.data = torch.tensor(bias)
    return sac


def test_actor_and_critics_of_the_pendulum_are_the_plain_programs(compute, pendulum):
    states = np.random.default_rng(0).uniform([-4, -8], [4, 8], (50, 2))
    theirs = compute(f"""const {{act, worth}} = toys.pendulum;
      return {LIST(states)}.map((state) => [act(state), worth(state)]);""")
    angle, speed = torch.tensor(states).T
    obs = torch.stack([angle.cos(), angle.sin(), speed / 8], -1)
    with torch.no_grad():
        mean, _ = pendulum.actor(obs)
        worth = pendulum.critic(obs, mean).amin(0)
    expected = np.stack([2 * mean[:, 0].tanh(), worth], -1)
    np.testing.assert_allclose(theirs, expected, atol=1e-9)


def test_networks_are_written_to_four_digits():
    layers = runpy.run_path(str(toys.FOLDER / "tables.py"))["layers"]
    net = plain.Actor(3, 1, torch.Generator().manual_seed(0)).net
    for layer, part in zip(net[::2], layers(net), strict=True):
        units = np.frombuffer(base64.b64decode(part["numbers"]), "<i2").astype(float)
        numbers = torch.cat([layer.weight.flatten(), layer.bias]).detach().numpy()
        np.testing.assert_allclose(
            part["scale"] * units, numbers, atol=1e-4 * np.abs(numbers).max()
        )


def test_the_actor_swings_the_pendulum_up_from_every_state(compute):
    """The pendulum stands still after ten seconds, and stood for two."""
    ends = compute("""const {step, act} = toys.pendulum, ends = [];
      for (let angle = -3; angle <= 3; angle++) for (let speed = -6; speed <= 6; speed += 3) {
        let state = [angle, speed], least = 1;
        for (let t = 0; t < 200; t++) {
          ({state} = step(state, act(state)));
          if (t >= 160) least = Math.min(least, Math.cos(state[0]));
        }
        ends.push(least);
      }
      return ends;""")
    assert len(ends) == 35
    assert min(ends) > 0.95


@pytest.fixture(scope="module")
def chapter_6():
    names = {"math": math}
    return cells("06_reward_variants.ipynb", "647d41a7", "1bc828f4", "9868e744", **names)


@pytest.mark.parametrize("kind", ["logit", "f", "mixture"])
@pytest.mark.parametrize(("alpha", "share"), [(0.2, 1.0), (0.2, 0.3), (5.0, 1.0)])
def test_rounds_of_the_loop_are_sacs_best_answers(compute, kind, alpha, share):
    theirs = compute(f"""const {{expert, round}} = toys.loop;
      const rounds = [expert.map(() => -Math.log(31))];
      for (let k = 0; k < 5; k++) rounds.push(round("{kind}", rounds[k], {alpha}, {share}));
      return [expert, ...rounds];""")
    f, *rounds = np.array(theirs)
    np.testing.assert_allclose(f, log_softmax(norm.logpdf(np.linspace(-1, 1, 31), 0, 0.3)))
    one = MDP(np.ones((1, 31, 1)), np.ones(1), 0.9)
    for before, after in itertools.pairwise(rounds):
        paid = {
            "logit": f - before,
            "f": f,
            "mixture": f - np.log(np.exp(before) / 2 + 1 / 62),
        }[kind]
        best = soft_value_iteration(one, paid[None], alpha).log_policy[0]
        expected = log_softmax((1 - share) * before + share * best)
        np.testing.assert_allclose(after, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("alpha", "share"), [(0.2, 1.0), (0.2, 0.3), (5.0, 1.0)])
def test_the_loop_overshoots_as_the_alternation_of_chapter_6(compute, chapter_6, alpha, share):
    """A small error grows by the same factor, in the toy and in the chapter's maze."""
    said, grown = compute(f"""const {{expert, round, slope}} = toys.loop;
      const most = (x) => Math.max(...x.map(Math.abs)), rest = 1 + {alpha};
      const total = Math.log(expert.reduce((sum, f) => sum + Math.exp(f / rest), 0));
      const still = expert.map((f) => f / rest - total);
      const p = still.map(Math.exp), error = expert.map((_, k) => (k % 2 ? 1e-6 : -1e-6) / p[k]);
      error[30] = 0;
      error[15] -= error.reduce((sum, e, k) => sum + p[k] * e, 0) / p[15];
      const after = round("logit", still.map((l, k) => l + error[k]), {alpha}, {share});
      return [slope("logit", {alpha}, {share}), (after[3] - still[3]) / error[3]];""")
    assert said == pytest.approx(1 - share * (1 + 1 / alpha))
    assert grown == pytest.approx(said, rel=1e-2)
    assert chapter_6["slope"](alpha, share) == pytest.approx(said, rel=1e-2)


WORLDS = {
    "again": ({}, {}),
    "wet": ({"slip": 0.3}, {"slip": 0.3}),
    "turned": ({"controls": "turned"}, {"order": grid_worlds.QUARTER}),
    "mirrored": ({"controls": "mirrored"}, {"order": grid_worlds.MIRROR}),
    "in a hurry": ({"gamma": 0.9}, {"discount": 0.9}),
    "wall moved": ({"wall": {"row": 4, "from": 2, "to": 11}},) * 2,
    "wall moved, wet and mirrored": (
        {"wall": {"row": 7, "from": 3, "to": 12}, "slip": 0.1, "controls": "mirrored"},
        {"wall": {"row": 7, "from": 3, "to": 12}, "slip": 0.1, "order": grid_worlds.MIRROR},
    ),
}


def world(path, wall=None, slip=0.0, order=(0, 1, 2, 3, 4), discount=0.97):
    """A world of chapter 12, from its own builders."""
    wall = wall or {"row": 7, "from": 0, "to": 9}
    start = int(tabular.maze(12, "Left").mdp.initial.argmax())
    path.write_text(LIST({"cells": 12, "wall": wall, "demonstrations": [{"states": [start]}]}))
    mdp = toys.maze(path, discount)
    dense = grid_worlds.dense(grid_worlds.turned(mdp, order))
    return replace(mdp, transition=(1 - slip) * dense + slip * dense.mean(1, keepdims=True))


@pytest.mark.parametrize("name", WORLDS)
def test_two_worlds_teach_what_the_package_says(compute, tmp_path, name):
    theirs, ours = WORLDS[name]
    noise = np.random.default_rng(0).normal(size=720)
    smallest, other = compute(f"""const {{world, doored, lesson}} = toys.worlds;
      const second = world({{wall: mazes.book(12, "Left").wall, ...{LIST(theirs)}}});
      return [undefined, Float64Array.from({LIST(noise)})].map((noise) => {{
        const found = lesson(second, doored({{row: 7, door: 1}}), noise);
        return {{...found, reward: [...found.reward], films: 0, own: 0}};
      }});""")
    truth, third = tabular.maze(12, "Left").reward, grid_worlds.wall()
    worlds = [world(tmp_path / "first"), world(tmp_path / "second", **ours)]
    assert (worlds[0].transition != tabular.maze(12, "Left").mdp.transition).nnz == 0
    films = [soft_value_iteration(mdp, truth, 0.05).log_policy for mdp in worlds]
    reward = tabular.shared_reward(worlds, films, 0.05)
    np.testing.assert_allclose(smallest["reward"], reward.ravel(), atol=1e-5)
    assert smallest["open"] == tabular.separation(worlds).free
    assert smallest["like"] == pytest.approx(
        np.corrcoef(reward.ravel(), np.repeat(truth, 5))[0, 1], abs=1e-5
    )
    copied, best, planned = (
        tabular.policy_return(third, np.exp(log_policy), truth)
        for log_policy in (
            films[0],
            *(soft_value_iteration(third, r, 0.05).log_policy for r in (truth, reward)),
        )
    )
    assert smallest["score"] == pytest.approx((planned - copied) / (best - copied), abs=1e-4)
    # The other reward fits the same films, and differs only where something is open.
    for mdp, film in zip(worlds, films, strict=True):
        same = soft_value_iteration(mdp, np.reshape(other["reward"], (144, 5)), 0.05).log_policy
        np.testing.assert_allclose(same, film, atol=1e-4)
    differs = np.std(np.subtract(other["reward"], smallest["reward"]))
    expected = np.std(truth) if smallest["open"] > 1 else 0
    assert differs == pytest.approx(expected, abs=1e-4)


def test_the_pendulum_is_steered_by_hand_and_by_the_actor(opened):
    view = opened("pendulum")
    says, canvas = view.locator(".toy-says"), view.locator(".toy canvas")
    state = partial(view.evaluate, "toys.all[0].state()")
    assert re.search(r"The actor steers\. Return −\d+ after 200 steps\. Upright", words(says))
    box = canvas.nth(1).bounding_box()
    view.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 0.4 * box["height"])
    assert 60 < state()["start"][0] < 160
    assert 0 < state()["start"][1] < 4
    assert "Upright since" in words(says)
    canvas.nth(1).press("ArrowUp")
    assert state()["time"] == 200
    view.get_by_role("radio", name="off").check()
    view.get_by_role("button", name="Hang it down").click()
    assert state()["state"] == pytest.approx([np.pi, 0])
    assert state()["total"] == pytest.approx(-200 * np.pi**2)
    canvas.nth(0).press("ArrowRight")
    assert state()["state"][1] > 1
    assert [point["mine"] for point in state()["trail"][-6:]] == [False, *[True] * 5]

    box, before = canvas.nth(0).bounding_box(), state()["time"]
    centre = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    view.mouse.move(centre[0] - 0.3 * box["width"], centre[1])
    view.mouse.down()
    view.wait_for_function(f"toys.all[0].state().time > {before + 5}")
    assert words(says).startswith("You steer")
    view.mouse.up()
    canvas.nth(0).press("Space")
    assert state()["steers"] == "actor"
    assert "Upright since" in words(says)


def test_a_policy_is_drawn_and_the_loop_runs_away(opened):
    view = opened("loop")
    says, canvas = view.locator(".toy-says"), view.locator(".toy canvas").first
    state = partial(view.evaluate, "toys.all[0].state()")
    box = canvas.bounding_box()
    drag(
        view,
        (box["x"] + 0.8 * box["width"], box["y"] + 0.6 * box["height"]),
        (box["x"] + 0.9 * box["width"], box["y"] + 0.4 * box["height"]),
    )
    drawn = state()
    assert sum(drawn["policy"][21:]) > 0.3
    assert drawn["chosen"] >= 26
    before = drawn["policy"][drawn["chosen"]]
    canvas.press("ArrowUp")
    after = state()["policy"][drawn["chosen"]]
    assert after == pytest.approx(2 * before / (1 + before))
    view.get_by_role("button", name="One round").click()
    assert "Round 1." in words(says)
    assert state()["policy"][drawn["chosen"]] < 1e-3
    view.evaluate("toys.all[0].finish()")
    assert state()["story"][-1] > 1e6
    view.get_by_text("f", exact=True).click()
    temperature = view.get_by_label("temperature α")
    assert temperature.get_attribute("aria-valuetext") == "0.2"
    temperature.fill("0")
    view.get_by_role("button", name="One round").click()
    assert "Distance to the expert: 0 %" in words(says)
    view.get_by_text("f − log mixture").click()
    view.evaluate("toys.all[0].finish()")
    assert max(state()["story"]) < 20


def test_a_second_film_is_changed_by_hand(opened):
    view = opened("worlds")
    says, canvas = view.locator(".toy-says"), view.locator(".toy canvas")
    state = partial(view.evaluate, "toys.all[0].state()")
    assert "leave 144 directions open" in words(says)
    assert "scores 0 %" in words(says)
    box = canvas.nth(1).bounding_box()
    size = (box["width"] - 14) / 12
    at = [(box["x"] + 7 + size * x, box["y"] + box["width"] - 7 - size * 7) for x in (4.5, 8.5)]
    drag(view, *at)
    assert state()["wall"] == {"row": 7, "from": 4, "to": 13}
    assert 1 < state()["open"] < 144
    canvas.nth(1).press("ArrowLeft")
    assert state()["wall"]["from"] == 3
    view.get_by_role("button", name="The same film again").click()
    view.get_by_label("commands that fail").press("ArrowRight")
    assert state()["change"]["slip"] == pytest.approx(0.05)
    assert "leave only a constant open" in words(says)
    box = canvas.nth(2).bounding_box()
    size = (box["width"] - 14) / 12
    at = [
        (box["x"] + 7 + size * x, box["y"] + box["width"] - 7 - size * y)
        for x, y in [(6, 7), (11, 5)]
    ]
    drag(view, *at)
    assert state()["fresh"] == {"row": 5, "door": 6}
    canvas.nth(2).press("ArrowRight")
    assert state()["fresh"] == {"row": 5, "door": 7}
    view.get_by_role("button", name="Another reward that fits").click()
    assert "at 1.00. Its plan in the new maze scores 100 %" in words(says)
    view.get_by_text("in a hurry").click()
    assert state()["change"]["gamma"] == 0.9


def test_the_toys_of_the_chapters_answer_to_the_mouse_and_to_keys(opened):
    view = opened("rewards", "corridor", "products", "life", "drawn_maze", "game", "squash")
    state = "toys.all[{}].state()"
    canvas = view.locator(".toy canvas")

    view.evaluate("toys.all[0].pose()")
    assert "First maze: 10" in said(view) or "First maze: 9" in said(view)
    assert re.search(r"Moved wall: −?\d %", said(view))
    view.get_by_text("a place: r(s)").click()
    assert re.search(r"Moved wall: (9\d|100) %", said(view))
    view.get_by_role("button", name="Add a shaping").click()
    assert "with a shaping" in said(view)
    canvas.nth(2).press("ArrowLeft")
    assert view.evaluate(state.format(0))["step"] == 129

    view.get_by_text("log D − log(1 − D)").click()
    view.evaluate("toys.all[1].finish()")
    says = view.locator(".toy-says").nth(1)
    assert "expert 100 %, imitator 100 %" in words(says)
    canvas.nth(3).press("ArrowDown")
    assert view.evaluate(state.format(1))["expert"] == pytest.approx(
        [0.95, 0.95, 0.95, 0.8, 0.95, 0.95, 0.95]
    )

    canvas.nth(4).scroll_into_view_if_needed()
    box = canvas.nth(4).bounding_box()
    middle, scale = box["width"] / 2, box["width"] / 5.2
    at = [
        (box["x"] + middle + scale * x, box["y"] + middle - scale * y)
        for x, y in [(0.9, 0.3), (-0.7, 0.3)]
    ]
    drag(view, *at)
    assert view.evaluate(state.format(2))["primitives"][0]["mean"] == pytest.approx(
        [-0.7, 0.3], abs=0.03
    )
    canvas.nth(4).press("ArrowUp")
    assert view.evaluate(state.format(2))["primitives"][0]["mean"][1] == pytest.approx(
        0.4, abs=0.03
    )

    for _ in range(4):
        canvas.nth(7).press("ArrowUp")
    says = view.locator(".toy-says").nth(3)
    assert "the agent never ends" in words(says)
    view.get_by_text("c, for ever").click()
    assert "the agent walks to the goal" in words(says)

    canvas.nth(8).scroll_into_view_if_needed()
    says = view.locator(".toy-says").nth(4)
    assert "arrives 3 cm from the star, after 29 moves" in words(says)
    view.get_by_role("button", name="Move the wall").click()
    assert view.evaluate(state.format(4))["wall"]["from"] == 12
    assert "arrives" in words(says)
    assert "(29 before the wall moved)" in words(says)
    box = canvas.nth(8).bounding_box()
    size = (box["width"] - 14) / 28
    at = [
        (box["x"] + 7 + size * (x + 0.5), box["y"] + box["width"] - 7 - size * (y + 0.5))
        for x, y in [(15, 3), (25, 12)]
    ]
    drag(view, *at)
    assert view.evaluate(state.format(4))["start"] == 25 + 28 * 12
    assert "arrives" in words(says)
    canvas.nth(8).press("Shift+ArrowLeft")
    assert view.evaluate(state.format(4))["start"] == 24 + 28 * 12
    assert view.evaluate(state.format(4))["wall"]["from"] == 12

    view.locator(".toy").nth(5).get_by_role("button", name="One round").click()
    says = view.locator(".toy-says").nth(5)
    assert "Round 1." in words(says)
    view.evaluate("toys.all[5].finish()")
    assert re.search(r"Round 60\. Distance of the visits: \de−[3-9]", words(says))

    box = view.locator(".toy").nth(6).locator("canvas")
    box.press("ArrowUp")
    assert view.evaluate(state.format(6))["std"] == pytest.approx(1.1)
