"""Exercises answer: the page's own solution is right, the stub is no error, mistakes have names."""

import importlib
import inspect
import random
import re

import nbformat
import numpy as np
import pytest
import scipy
import torch
from test_form import CHAPTERS, names

import exercises

START = re.compile(r"\{solution(?:-start)?\} (\S+)")
HINTS = re.compile(
    r":::\{admonition\} Hint\n:class: dropdown tip\n\n.+\n:::\n\n"
    r":::\{admonition\} A stronger hint\n:class: dropdown tip\n\n.+\n:::"
)


def tagged(cell):
    return "exercise" in cell.metadata.get("tags", [])


def of_page(path):
    return nbformat.read(path, as_version=4).cells


def stubs():
    """Each exercise with a check: its page, the number of its cell and its label."""
    for path in CHAPTERS:
        for number, cell in enumerate(of_page(path)):
            if cell.cell_type == "code" and tagged(cell):
                yield path, number, re.search(r'check\("([\w-]+)",', cell.source)[1]


STUBS = list(stubs())
LABELS = [label for *_, label in STUBS]
EACH = pytest.mark.parametrize(("path", "number", "label"), STUBS, ids=LABELS)


def solution(path, label):
    """The first program of a solution that defines a function, and the function's name."""
    inside = False
    for cell in of_page(path):
        if found := START.search(cell.source):
            inside = found[1] == label
        if inside:
            fenced = re.findall(r"```python\n(.*?)\n```", cell.source, re.DOTALL)
            for code in [cell.source] if cell.cell_type == "code" else fenced:
                if name := re.search(r"(?m)^def (\w+)", code):
                    return code, name[1]
    raise LookupError(label)


def imported(path, wanted):
    """The names of a page that its import statements make, of those that are wanted."""
    everything = {}
    for cell in of_page(path):
        if cell.cell_type == "code" and not tagged(cell):
            for line in re.findall(
                r"(?m)^(?:import|from) [\w.]+(?: (?:as|import) .*)?$", cell.source
            ):
                if not line.endswith("(") and names(line)[0] & wanted:
                    exec(line, everything)
    return {name: everything[name] for name in wanted & set(everything)}


def solved(path, label):
    """A page's own solution, with what the page imports and nothing else."""
    code, name = solution(path, label)
    scope = imported(path, names(code)[1])
    exec(re.split(r"(?m)^assert ", code)[0], scope)
    return scope[name]


def test_chapters_one_to_eight_have_exercises_that_answer():
    pages = {path.stem[:2] for path, *_ in STUBS}
    assert {f"{number:02}" for number in range(1, 9)} <= pages
    assert len(set(LABELS)) == len(LABELS)


def test_every_judge_has_its_exercise():
    judges = {name for name in vars(exercises) if name.startswith("ex_")}
    assert judges == {label.replace("-", "_") for label in LABELS}


@EACH
def test_an_exercise_is_a_stub_two_hints_and_a_solution(path, number, label):
    cells = of_page(path)
    text, stub, hints, answer = cells[number - 1 : number + 3]
    assert f":label: {label}\n" in text.source
    assert len(stub.source.splitlines()) <= 12
    assert stub.source.count("    return ...\n") == 1
    assert stub.metadata.tags == hints.metadata.tags == ["exercise"]
    assert HINTS.fullmatch(hints.source)
    assert START.search(answer.source)[1] == label
    code, name = solution(path, label)
    assert max(map(len, code.splitlines())) <= 76
    given = re.search(r"def \w+\((.*)\):", stub.source)[1].split(", ")
    assert re.search(rf"def {name}\((.*)\):", code)[1].split(", ") == given


@EACH
def test_the_solution_is_right_and_the_stub_says_that_nothing_is_there(
    path, number, label, capsys, monkeypatch
):
    monkeypatch.setenv("OFFAIRL_STRICT", "1")
    exec(of_page(path)[number].source, {})
    assert capsys.readouterr().out.startswith("Not yet filled in")
    exercises.check(label, solved(path, label))
    assert capsys.readouterr().out == "Right.\n"


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_an_exercise_leaves_no_trace_in_its_page(path):
    """No other cell and no statement uses a name of its cell; `portable.py` leaves it out."""
    made, theirs = set(), set()
    for cell in of_page(path):
        if cell.cell_type == "code":
            both = names(cell.source)
            if tagged(cell):
                made |= both[0]
            else:
                theirs |= set.union(*both)
    for statement in importlib.import_module("checks").statements(path.stem):
        theirs |= set(inspect.signature(statement).parameters)
    assert made & theirs == set()


@EACH
def test_a_check_draws_no_number_that_a_page_would_draw(path, number, label):
    def drawn(*answers):
        np.random.seed(0)  # noqa: NPY002
        torch.manual_seed(0)
        random.seed(0)
        for answer in answers:
            exercises.verdict(label, answer)
        return np.random.rand(), torch.rand(1).item(), random.random()  # noqa: NPY002

    assert drawn(lambda *_: None, lambda *_: ..., solved(path, label)) == drawn()


def stops(*_):
    raise ValueError("no such state")


@pytest.mark.parametrize("label", LABELS)
def test_what_stops_or_is_no_number_is_said_in_a_line(label):
    said = exercises.verdict(label, stops)
    assert said == "It stops: ValueError: no such state"
    assert exercises.verdict(label, lambda *_: undefined) == (
        "It stops: name 'undefined' is not defined. Have the page's cells above been run? "
        "In JupyterLab: Run, Run All Above Selected Cell."
    )
    for output in ("a word", np.zeros((7, 7, 7)), np.zeros(0), float("nan")):
        said = exercises.verdict(label, lambda *_, output=output: output)
        assert said.startswith("Not yet. "), output
        assert "\n" not in said
    assert exercises.verdict(label, lambda: 0).startswith("It stops: TypeError")


def lse(x, axis=-1):
    return scipy.special.logsumexp(x, axis=axis)


def by_state(P, initial, T):
    mu = np.zeros((len(P), T))
    mu[:, 0] = initial
    for s in range(len(P)):
        for t in range(T - 1):
            mu[s, t + 1] = mu[:, t] @ P[:, s]
    return mu


def by_time(P, initial, T):
    return np.stack([initial @ np.linalg.matrix_power(P, t) for t in range(T)], 1)


def share(counts):
    return counts / counts.sum()


def cross_entropy(logit, label):
    return torch.nn.functional.binary_cross_entropy_with_logits(logit, label)


def stacked(f, log_pi, label):
    label = label[:, None].expand(-1, 2)
    return cross_entropy(torch.stack([f, log_pi], 1), label)


def divided(f, log_pi, label):
    d = f.exp() / (f.exp() + log_pi.exp())
    return -(label * d.log() + (1 - label) * (1 - d).log()).mean()


def reached(successors):
    """The groups of states that steps connect, whatever they have in common."""
    group = np.arange(len(successors))
    for state, following in enumerate(successors):
        for other in following:
            group[group == group[other]] = group[state]
    return len(np.unique(group))


def target(sign=1, entropy=1, inside=True, least=True, ends=True):
    """The target y with some of the paper's mistakes."""

    def y(r, end, q, log_pi, alpha, gamma):
        value = q.amin(0) if least else q[0]
        bonus = -entropy * alpha * log_pi
        live = gamma * (1 - ends * end) * sign
        return r + live * (value + bonus) if inside else r + live * value + bonus

    return y


def normal(x, mean, log_std):
    return torch.distributions.Normal(mean, log_std.exp()).log_prob(x)


def answered(reward, alpha):
    return reward / alpha - lse(reward / alpha)


def released(a, mean, std, weight):
    sigma = 1 / (weight / std).sum()
    return scipy.stats.norm.logpdf(a, sigma * (weight / std * mean).sum(), sigma)


def densities(a, mean, std):
    return scipy.stats.norm.logpdf(a[:, None], mean, std)


def lagged(delay, bootstrap=True):
    def slow(updates, r, gamma, tau):
        value = 0.0
        for _ in range(updates // delay):
            value += tau * (r + bootstrap * gamma * value - value)
        return value

    return slow


def shaped(now, later):
    """A reward that adds two functions of s and of s'."""

    def table(S, A, gamma):
        potential = np.arange(S) ** 2
        both = later(gamma) * potential - now(gamma) * potential[:, None]
        return np.repeat(both[:, None], A, axis=1)

    return table


def free(worlds):
    """The directions that are shapings in all worlds, from the matrices of shapings."""
    shown = sum(np.eye(len(a)) - a @ np.linalg.pinv(a) for a in worlds)
    return len(shown) - np.linalg.matrix_rank(shown, 1e-8)


# What a reader may write, and what the page then says.
MISTAKES = [
    ("ex-hard", lambda q, alpha: q.max(1), "hard maximum"),
    ("ex-hard", lambda q, alpha: lse(q), "temperature is missing"),
    ("ex-hard", lambda q, alpha: lse(q / alpha), "multiply by α outside"),
    ("ex-hard", lambda q, alpha: alpha * np.log(np.exp(q / alpha).mean(1)), "averages"),
    ("ex-hard", lambda q, alpha: alpha * np.log(np.exp(q / alpha).sum(1)), "overflows"),
    ("ex-hard", lambda q, alpha: alpha * lse(q / alpha, 0), r"the shape \(3,\)"),
    ("ex-hard", lambda q, alpha: q.mean(1), "α log 2 = 0.21; yours is 0.00"),
    ("ex-order", by_state, r"add up to \d\.\d, not to 8\. Which entries"),
    ("ex-order", lambda P, initial, T: by_time(P.T, initial, T), "Backwards"),
    ("ex-order", lambda P, initial, T: by_time(P, initial, T).T, "columns are times"),
    ("ex-order", lambda P, initial, T: by_time(P, initial, T) / T, "add up to 1.0, not to 8"),
    ("ex-gail-sign", lambda logit: -np.logaddexp(0, logit), "pays for being found out"),
    ("ex-gail-sign", lambda logit: np.logaddexp(0, -logit), "unlike the expert"),
    ("ex-gail-sign", lambda logit: -np.logaddexp(0, -logit), "never positive"),
    ("ex-gail-sign", lambda logit: logit, "reward log 2"),
    ("ex-gail-sign", lambda x: -np.log(1 - scipy.special.expit(x)), "softplus"),
    ("ex-best-logit", lambda e, p: np.log(e / p), "compare shares"),
    ("ex-best-logit", lambda e, p: np.log(share(p) / share(e)), "Upside down"),
    ("ex-best-logit", lambda e, p: share(e) / (share(e) + share(p)), "This is D"),
    ("ex-best-logit", lambda e, p: share(e) / share(p), "This is the ratio"),
    ("ex-best-logit", lambda e, p: 0 * e, r"slope in the first logit is -0\.2[78]"),
    ("ex-two-logits", stacked, "Two logits, averaged"),
    ("ex-two-logits", lambda f, log_pi, y: cross_entropy(f, y), "log π is missing"),
    ("ex-two-logits", lambda f, log_pi, y: cross_entropy(f + log_pi, y), "sign of log π"),
    ("ex-two-logits", lambda f, log_pi, y: cross_entropy(f - log_pi, 1 - y), "1 is the expert"),
    ("ex-two-logits", lambda f, log_pi, y: (f - log_pi).mean(), "has the logit"),
    ("ex-two-logits", divided, "Work with the logit"),
    ("ex-links", reached, "link a state to its successors"),
    ("ex-links", lambda successors: len(successors), "16.0 for a torus"),
    ("ex-broadcast", lambda q, y: (q - y).square().mean(), r"is \(B, B\)"),
    ("ex-broadcast", lambda q, y: (q[:, 0] - y).square().sum(), "Take the mean"),
    ("ex-broadcast", lambda q, y: (q[:, 0] - y).square(), "Take their mean"),
    ("ex-broadcast", lambda q, y: (q[:, 0] - y.mean()).square().mean(), "all estimates are right"),
    ("ex-printed-gradient", target(-1, -1, inside=False, least=False, ends=False), "Five things"),
    ("ex-printed-gradient", target(ends=False), "follows a termination"),
    ("ex-printed-gradient", target(sign=-1), "sign of the next value"),
    ("ex-printed-gradient", target(entropy=-1), "sign of the entropy"),
    ("ex-printed-gradient", target(inside=False), "belongs to the next state"),
    ("ex-printed-gradient", target(least=False), "smaller counts"),
    ("ex-printed-gradient", target(entropy=0), "min Q - α log π"),
    ("ex-jacobian", normal, r"integrates to 0\.8\d, not to 1: it is that of u, taken at a"),
    (
        "ex-jacobian",
        lambda a, *of: normal(torch.atanh(a), *of),
        r"integrates to 0\.7\d, not to 1: the Jacobian of tanh is missing",
    ),
    (
        "ex-jacobian",
        lambda a, *of: normal(torch.atanh(a), *of) + torch.log(1 - a**2),
        "wrong sign",
    ),
    ("ex-jacobian", lambda a, *of: 0 * a, "integrates to 2.00, not to 1: is the Jacobian right"),
    ("ex-clamp", lambda f, log_pi, alpha: answered(f - log_pi, alpha), "not clamped"),
    (
        "ex-clamp",
        lambda f, log_pi, alpha: answered(f - np.minimum(log_pi, -5), alpha),
        "wrong side",
    ),
    ("ex-clamp", lambda f, log_pi, alpha: (f - np.maximum(log_pi, -5)) / alpha, "add up to 1"),
    ("ex-clamp", lambda f, log_pi, alpha: answered(f - np.maximum(log_pi, -5), 1), "temperature"),
    ("ex-clamp", lambda f, log_pi, alpha: answered(f, alpha), "softmax of"),
    ("ex-blind", lambda S, A, gamma: np.ones((S, A, S)), "It is constant"),
    ("ex-blind", lambda S, A, gamma: np.arange(S * A * S).reshape(S, A, S), "on the action"),
    ("ex-blind", shaped(lambda gamma: 1, lambda gamma: 0), "sees s alone"),
    ("ex-blind", shaped(lambda gamma: 1, lambda gamma: 1), "γ times"),
    ("ex-blind", shaped(lambda gamma: -1, lambda gamma: gamma), "canonical form still has 95%"),
    ("ex-blind", shaped(lambda gamma: gamma, lambda gamma: 1), "canonical form still has"),
    ("ex-one-flag", lambda r, e, c, v, g: r + g * (1 - np.maximum(e, c)) * v, "no end"),
    ("ex-one-flag", lambda r, e, c, v, g: r + g * v, "nothing follows"),
    ("ex-one-flag", lambda r, e, c, v, g: r + g * (1 - c) * v, "wrong way round"),
    ("ex-one-flag", lambda r, e, c, v, g: r, "nothing has ended"),
    ("ex-loops", lambda n, m, w: np.log((n + w) / (m + w)), "Upside down"),
    ("ex-loops", lambda n, m, w: np.log(m / n), "loops are rows"),
    ("ex-loops", lambda n, m, w: np.log(w / w), "What share"),
    ("ex-loops", lambda n, m, w: w / (n + w), r"400 \+ 1 rows"),
    ("ex-log-product", lambda a, m, s, w: densities(a, m, s) @ w, "log Z is missing"),
    ("ex-log-product", lambda a, m, s, w: lse(np.log(w) + densities(a, m, s)), "the sum of"),
    ("ex-log-product", released, "not w / σ"),
    ("ex-log-product", lambda a, m, s, w: 0 * a, "a Gaussian whose precision"),
    ("ex-why-not-add", lambda a, m, s, w: densities(a, m, s) @ w, "product"),
    ("ex-why-not-add", lambda a, m, s, w: np.exp(densities(a, m, s)) @ w, "its logarithm"),
    ("ex-why-not-add", lambda a, m, s, w: lse(densities(a, m, s)), "weights are missing"),
    ("ex-why-not-add", lambda a, m, s, w: lse(w + densities(a, m, s)), "add densities"),
    ("ex-why-not-add", lambda a, m, s, w: np.log(np.exp(densities(a, m, s)) @ w), "round to 0"),
    ("ex-wilson", lambda n: 0.05 ** (1 / n), "both sides"),
    ("ex-wilson", lambda n: 0.975 ** (1 / n), "How small"),
    ("ex-wilson", lambda n: 1 - 0.025 ** (1 / n), "not to arrive"),
    ("ex-wilson", lambda n: 0.9, "arrive in 59.0 % of the cases"),
    ("ex-lag", lagged(1), "every second update"),
    ("ex-lag", lambda k, r, gamma, tau: r / (1 - gamma), "not there yet"),
    ("ex-lag", lagged(2, bootstrap=False), "not r alone"),
    ("ex-lag", lambda k, r, gamma, tau: r, r"After 600 updates it is at -9\.0"),
    ("ex-third-film", lambda worlds: free(worlds) - 1, "Constants"),
    ("ex-third-film", lambda worlds: free(worlds[:2]), "only the first two"),
    ("ex-third-film", lambda worlds: free(worlds[-2:]), "only the last two"),
    ("ex-third-film", lambda worlds: len(worlds), "for 2 films"),
]


@pytest.mark.parametrize(
    ("label", "answer", "sentence"),
    MISTAKES,
    ids=[f"{label}-{number}" for number, (label, *_) in enumerate(MISTAKES)],
)
def test_a_typical_mistake_is_called_by_its_name(label, answer, sentence):
    said = exercises.verdict(label, answer)
    assert said.startswith("Not yet. ")
    assert re.search(sentence, said)


def test_no_named_mistake_is_left_untried(monkeypatch):
    named, made = {}, {}
    compare = exercises.expect

    def note(output, right, mistakes, hint):
        named[label] = max(named.get(label, 0), len(mistakes))
        try:
            compare(output, right, mistakes, hint)
        except exercises.Wrong as wrong:
            if str(wrong) in mistakes:
                made.setdefault(label, set()).add(list(mistakes).index(str(wrong)))
            raise

    monkeypatch.setattr(exercises, "expect", note)
    for label, answer, _ in MISTAKES:
        exercises.verdict(label, answer)
    assert {label: len(numbers) for label, numbers in made.items()} == named
    assert set(named) == set(LABELS) - {"ex-blind"}
