// A reward of the square and one of the move, as the optimiser of chapter 1 learns them.
(() => {
  const {A, build, book, solve, visits, maxent, score, walk, likeliest, board, ...paint} =
    window.toys.mazes;
  const n = 20, S = n * n, gamma = 0.97, alpha = 0.05, last = 150, every = 3;
  const SIDES = ["Left", "Right"];
  const MAZES = SIDES.map((side) => ({...book(n, side), to: build(n, book(n, side).wall)}));
  const start = new Float64Array(S);
  start[MAZES[0].start] = 1;

  // Planning with a reward in a maze: the policy, and its true return from the start.
  // `guess` are values to begin with.
  function planned({to, reward: truth}, reward, temperature, guess) {
    const {policy, value: values} = solve(to, reward, temperature, gamma, {guess});
    return {policy, values, value: score(visits(to, policy, start, gamma), policy, truth)};
  }

  // What the optimiser sees: the exact visits of an expert that starts everywhere.
  function expert() {
    const [{to, reward}] = MAZES, {policy} = solve(to, reward, alpha, gamma);
    const initial = new Float64Array(S).fill(1 / S), d = visits(to, policy, initial, gamma);
    return {policy, initial, seen: policy.map((p, i) => p * d[Math.floor(i / A)])};
  }

  // γΦ(s') - Φ(s) of the first maze, for a potential that is noise.
  function shaping() {
    let seed = 7;
    const random = () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32;
    const phi = Array.from({length: S}, () => random() + random() + random() - 1.5);
    return Float64Array.from({length: S * A}, (_, i) =>
      0.3 * (gamma * phi[MAZES[0].to[i]] - phi[Math.floor(i / A)]));
  }

  const shaped = (reward, extra) =>
    extra.map((v, i) => v + reward[reward.length === S ? Math.floor(i / A) : i]);

  function define(toy) {
    const {policy: old, initial, seen} = expert(), noise = shaping();
    const best = MAZES.map((maze) => planned(maze, maze.reward, alpha).value);
    const worst = score(visits(MAZES[1].to, old, start, gamma), old, MAZES[1].reward);
    const percent = (value, k) => Math.round((100 * (value - worst)) / (best[k] - worst));
    const fits = {state: [], pair: []}, curves = {state: [], pair: []}, values = {};
    const lessons = {state: maxent(MAZES[0].to, seen, initial, alpha, gamma, true),
      pair: maxent(MAZES[0].to, seen, initial, alpha, gamma, false)};
    let kind = "pair", step = 0, temperature = alpha, extra = false, follow = true, now = null;

    function think() {
      const base = fits[kind][Math.min(step, fits[kind].length - 1)];
      const reward = extra ? shaped(base, noise) : base;
      const plans = MAZES.map((maze, k) => planned(maze, reward, temperature, now?.plans[k].values));
      const sorted = Float64Array.from(reward).sort();
      now = {reward, plans, low: sorted[Math.floor(sorted.length * 0.03)],
        high: sorted[Math.floor((sorted.length - 1) * 0.999)]};
      const [first, second] = plans.map(({value}, k) => percent(value, k));
      const said = (x) => `${Math.max(-99, x)} %`.replace("-", "−");
      toy.say(`${kind === "pair" ? "r(s, a)" : "r(s)"}${extra ? " with a shaping" : ""} after `
        + `${step} steps. First maze: ${said(first)}. Moved wall: ${said(second)} of the expert.`,
        follow && step < last);
    }

    function learn(which) {
      const made = fits[which];
      made.push(lessons[which].next().value);
      const k = made.length - 1;
      if (k % every) return;
      const plan = planned(MAZES[1], made[k], alpha, values[which]);
      values[which] = plan.values;
      curves[which].push([k, percent(plan.value, 1)]);
    }

    MAZES.forEach((maze, k) => toy.pane({
      shape: "toy-half",
      title: ["first maze", "wall moved"][k],
      label: ["The first maze", "The maze after the wall has moved"][k]
        + ", coloured by the reward, with the arrows of the policy that is planned on it.",
      scale: ["low reward", "high"],
      draw: (ctx, w, h, colour) => {
        const b = board(n, w), {reward, plans, low, high} = now;
        const shade = (i) => window.toys.shade(colour.reward, (reward[i] - low) / (high - low || 1));
        paint.squares(ctx, b, (s) => (reward.length === S ? shade(s) : colour.floor), colour);
        if (reward.length > S) paint.triangles(ctx, b, shade);
        paint.arrows(ctx, b, plans[k].policy, colour.ink);
        const way = walk(maze.to, likeliest(plans[k].policy), maze.start);
        window.toys.line(ctx, way.map(b.centre), colour.card, 7);
        window.toys.line(ctx, way.map(b.centre), colour.learner, 4.5);
        window.toys.star(ctx, ...b.centre(maze.goal), Math.max(8, 0.8 * b.size), colour.star, colour.rim);
        paint.wall(ctx, b, maze.wall, colour);
        paint.walker(ctx, ...b.centre(way[way.length - 1]), Math.max(6, 0.55 * b.size),
          colour.learner, colour);
      },
    }));

    const place = (w, h) => ({x: 42, y: 24, w: w - 60, h: h - 62});
    const plot = toy.pane({
      label: "The score after the wall has moved, against the steps of the optimiser.",
      help: "Arrow keys choose the step.",
      ratio: 0.3,
      narrow: 0.55,
      shape: "toy-full",
      draw: (ctx, w, h, colour) => {
        const range = [0, last, -5, 105], box = place(w, h);
        const at = window.toys.axes(ctx, box, range, colour, {x: [0, 50, 100, 150], y: [0, 50, 100],
          xLabel: "steps of the optimiser", yLabel: "score after the wall has moved, %"});
        ctx.save();
        ctx.beginPath();
        ctx.rect(box.x, box.y - 4, box.w + 8, box.h + 8);
        ctx.clip();
        for (const [which, paintOf] of [["state", colour.good], ["pair", colour.policy]])
          window.toys.line(ctx, curves[which].map(([x, y]) => at(x, y)), paintOf, which === kind ? 4 : 2);
        ctx.restore();
        const edge = at(Math.min(step, last), 0)[0];
        window.toys.line(ctx, [[edge, box.y], [edge, box.y + box.h]], colour.ink, 1.5, {dash: [4, 4]});
        const y = Math.max(0, Math.min(104, percent(now.plans[1].value, 1)));
        window.toys.dot(ctx, ...at(step, y), 7, colour.learner, colour.rim);
        window.toys.text(ctx, "r(s)", at(138, 0)[0], at(0, 84)[1], {colour: colour.good});
        window.toys.text(ctx, "r(s, a)", at(134, 0)[0], at(0, 14)[1], {colour: colour.policy});
      },
      grab: (x, y, ask) => ask || choose(x) || true,
      drag: choose,
      keys: {ArrowLeft: () => go(step - 1), ArrowRight: () => go(step + 1)},
    });

    function choose(x) {
      const box = place(plot.w, plot.h);
      go(Math.round(((x - box.x) / box.w) * last));
    }

    function go(k) {
      follow = false;
      step = Math.max(0, Math.min(k, fits[kind].length - 1));
      slider.set(step);
      think();
    }

    toy.choice("The reward pays for", {state: "a place: r(s)", pair: "a move: r(s, a)"}, kind, (key) => {
      kind = key;
      step = Math.min(step, fits[kind].length - 1);
      slider.set(step);
      think();
    });
    const button = toy.button("Add a shaping", () => {
      extra = !extra;
      button.setAttribute("aria-pressed", extra);
      think();
    });
    const slider = toy.slider("steps of the optimiser", {min: 0, max: last, value: 0}, go);
    toy.slider("temperature of the policy", {min: 0.01, max: 0.2, step: 0.01, value: alpha,
      show: (x) => x.toFixed(2)}, (x) => { temperature = x; think(); });

    ["state", "pair"].forEach(learn);
    think();
    toy.play(() => {
      for (const until = performance.now() + 12; performance.now() < until;) {
        const next = fits.pair.length <= fits.state.length ? "pair" : "state";
        if (fits[next].length > last) return false;
        learn(next);
      }
      const reached = fits[kind].length - 1, next = reached - (reached % every);
      if (follow && next > step) {
        step = next;
        slider.set(step);
        think();
      }
      return true;
    });
    return {
      state: () => ({kind, step, extra, fits, curves, now}),
      pose: () => {
        for (const which of ["state", "pair"]) while (fits[which].length <= last) learn(which);
        go(130);
      },
    };
  }

  window.toys.rewards = {n, alpha, gamma, MAZES, expert, planned, shaping, shaped};
  window.toys.definitions.rewards = define;
})();
