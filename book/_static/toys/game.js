// The game of chapter 3 in rounds, on a grid, with the best discriminator in every round.
(() => {
  const {A, build, book, solve, visits, board, ...paint} = window.toys.mazes;
  const n = 12, S = n * n, gamma = 0.95, rounds = 60;
  const LEFT = book(n, "Left"), TO = build(n, LEFT.wall);
  const initial = new Float64Array(S).fill(1 / S);

  function expert() {
    const {policy} = solve(TO, LEFT.reward.map((r) => r / 0.1), 1, gamma);
    return {policy, d: visits(TO, policy, initial, gamma)};
  }

  // What a round compares: half the sum of all differences of visits, as a share, and the largest
  // error of the reward, which is log(d_E / d_π).
  function compare(theirs, policy) {
    const d = visits(TO, policy, initial, gamma);
    let far = 0;
    for (let i = 0; i < S * A; i++) {
      const s = Math.floor(i / A);
      far += Math.abs(theirs.d[s] * theirs.policy[i] - d[s] * policy[i]);
    }
    const gap = d.map((x, s) => Math.log(theirs.d[s] / x));
    return {d, gap, distance: (far * (1 - gamma)) / 2, error: Math.max(...gap) - Math.min(...gap)};
  }

  // One round: f of the best discriminator, the best response, and a step η of log π towards it.
  function round(theirs, policy, eta, sign = 1) {
    const {gap} = compare(theirs, policy);
    const f = policy.map((p, i) =>
      Math.log(p) + sign * (gap[Math.floor(i / A)] + Math.log(theirs.policy[i] / p)));
    const {q, value} = solve(TO, f, 1, gamma), next = new Float64Array(S * A);
    for (let s = 0; s < S; s++) {
      let total = 0;
      const logs = [];
      for (let i = s * A; i < s * A + A; i++)
        logs.push((1 - eta) * Math.log(policy[i]) + eta * (q[i] - value[s]));
      const most = Math.max(...logs);
      logs.forEach((l) => { total += Math.exp(l - most); });
      logs.forEach((l, a) => { next[s * A + a] = Math.max(1e-300, Math.exp(l - most) / total); });
    }
    return next;
  }

  function define(toy) {
    const theirs = expert(), uniform = new Float64Array(S * A).fill(1 / A);
    let policy, now, story, eta = 0.2, sign = 1;

    const over = () => story.length > rounds;

    function look() {
      now = compare(theirs, policy);
      story.push([now.distance, now.error]);
      const most = (x) => (x < 0.01 ? x.toExponential(0).replace("-", "−") : x.toFixed(2));
      toy.say(`Round ${story.length - 1}. Distance of the visits: ${most(now.distance)}. Error of the `
        + `reward, largest minus smallest: ${most(now.error)}.`, game.playing && !over());
    }

    function restart() {
      [policy, story] = [uniform, []];
      if (sign < 0) { // The expert is a fixed point: begin beside it.
        policy = theirs.policy.map((p) => p ** 0.9);
        for (let s = 0; s < S; s++) {
          const total = policy.subarray(s * A, s * A + A).reduce((a, b) => a + b);
          for (let a = 0; a < A; a++) policy[s * A + a] /= total;
        }
      }
      look();
    }

    function step() {
      policy = round(theirs, policy, eta, sign);
      look();
    }

    const maze = (title, label, fill, arrows) => toy.pane({title, label, shape: "toy-half",
      draw: (ctx, w, h, colour) => {
        const b = board(n, w);
        paint.squares(ctx, b, (s) => fill(s, colour), colour);
        if (arrows) paint.arrows(ctx, b, policy, colour.ink);
        window.toys.star(ctx, ...b.centre(LEFT.goal), Math.max(8, 0.4 * b.size), colour.star, colour.rim);
        paint.wall(ctx, b, LEFT.wall, colour);
      }});
    maze("the policy", "Where the policy is, with its arrows.",
      (s, colour) => window.toys.shade(colour.visits, Math.sqrt(now.d[s] / 5)), true);
    maze("reward's error", "The logarithm of the expert's visits over the policy's.",
      (s, colour) => window.toys.shade(colour.difference, 0.5 + now.gap[s] / 6));

    toy.pane({
      label: "Distance of the visits and largest error of the reward, against rounds.",
      shape: "toy-full",
      ratio: 0.3,
      narrow: 0.55,
      draw: (ctx, w, h, colour) => {
        const box = {x: 42, y: 24, w: w - 60, h: h - 62}, range = [0, rounds, -4, 1.5];
        const to = window.toys.axes(ctx, box, range, colour, {x: [0, 20, 40, 60], y: [-4, -2, 0],
          xLabel: "round", yShow: (v) => ({"-4": "10⁻⁴", "-2": "10⁻²", 0: "1"})[v]});
        [[0, colour.expert, "distance of the visits"], [1, colour.policy, "error of the reward"]]
          .forEach(([k, ink, name]) => {
            const points = story.map((both, i) => to(i, Math.max(-4, Math.log10(both[k]))));
            window.toys.line(ctx, points, ink, 3);
            window.toys.dot(ctx, ...points[points.length - 1], 5, ink);
            window.toys.text(ctx, name, box.x + box.w, box.y + 4 + 18 * k, {align: "right", colour: ink});
          });
      },
    });

    const again = () => { restart(); game.playing = true; };
    toy.choice("Step η", {1: "1", 0.5: "0.5", 0.2: "0.2", 0.1: "0.1"}, "0.2", (key) => { eta = +key; again(); });
    toy.choice("Label 1", {1: "the expert", "-1": "the policy"}, "1", (key) => { sign = +key; again(); });
    const game = toy.rounds({step, restart, over, pause: 0.06});
    restart();
    return {state: () => ({eta, sign, round: story.length - 1, story}), finish: game.finish,
      pose: () => { for (let k = 0; k < 3; k++) step(); }};
  }

  window.toys.game = {expert, compare, round};
  window.toys.definitions.game = define;
})();
