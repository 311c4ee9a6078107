// Chapter 6 with one state: a policy over actions, the reward that it is paid, and SAC's answer.
(() => {
  const K = 31, WIDTH = 0.3, rounds = 12, LIMIT = 1e6;
  const actions = [...Array(K).keys()].map((k) => (2 * k) / (K - 1) - 1);

  function normalised(logs) {
    const most = Math.max(...logs);
    const total = most + Math.log(logs.reduce((sum, l) => sum + Math.exp(l - most), 0));
    return logs.map((l) => l - total);
  }
  const bump = (mean, width) => normalised(actions.map((a) => -(((a - mean) / width) ** 2) / 2));
  const expert = bump(0, WIDTH);

  // What is paid for each action, while the policy has the logarithms `logPi`.
  const REWARDS = {
    logit: {name: "f − log π", of: (l, f) => f - l},
    f: {name: "f", of: (l, f) => f},
    mixture: {name: "f − log mixture", of: (l, f) => f - Math.log(Math.exp(l) / 2 + 0.5 / K)},
  };
  const paid = (kind, logPi) => logPi.map((l, k) => REWARDS[kind].of(l, expert[k]));

  // A round: a share η of the way of log π towards SAC's best answer at the temperature α.
  function round(kind, logPi, alpha, share) {
    const best = normalised(paid(kind, logPi).map((r) => r / alpha));
    return normalised(logPi.map((l, k) => (1 - share) * l + share * best[k]));
  }

  // By how much a small error grows in a round, where the policy is paid for being improbable.
  const slope = (kind, alpha, share) => 1 - share * (kind === "logit" ? 1 + 1 / alpha : 1);

  function define(toy) {
    const usual = bump(-0.12, 0.36);
    let first = usual, kind = "logit", alpha = 0.2, share = 1, logPi, reward, story, chosen = 15;
    const spread = () => Math.max(...reward) - Math.min(...reward);
    const show = (x) => (Math.abs(x) < 10 ? x.toFixed(Math.abs(x) < 0.1 ? 3 : 1)
      : Math.round(x).toLocaleString("en")).replace(/^-(?=[0.]*$)/, "").replace("-", "−");

    const over = () => story.length > rounds || spread() > LIMIT;

    function tell() {
      const error = kind === "mixture" ? ""
        : ` A round multiplies small errors by ${show(slope(kind, alpha, share))}.`;
      const far = logPi.reduce((sum, l, k) => sum + Math.abs(Math.exp(l) - Math.exp(expert[k])) / 2, 0);
      toy.say(`Round ${story.length - 1}. The reward's spread: ${show(spread())}. Distance to the expert: `
        + `${Math.round(100 * far)} %.${error}`, game.playing && !over());
    }

    function step() {
      logPi = round(kind, logPi, alpha, share);
      reward = paid(kind, logPi);
      story.push(spread());
      tell();
    }

    function restart(fresh = false) {
      if (fresh) first = usual;
      [logPi, reward] = [first, paid(kind, first)];
      story = [spread()];
      tell();
    }

    function paint(k, p) {
      const rest = logPi.map(Math.exp);
      rest[k] = Math.min(0.9, Math.max(1e-4, p));
      first = normalised(rest.map((x) => Math.log(Math.max(1e-300, x))));
      [chosen, game.playing] = [k, false];
      restart();
    }

    const top = () => Math.max(0.2, Math.exp(Math.max(...logPi)) * 1.1);
    const box = (w, h) => ({x: 48, y: 24, w: w - 58, h: h - 62});
    const bars = (ctx, b, to, values, base, ink) => values.forEach((v, k) => {
      const [x, y] = to(actions[k], v), ground = to(0, base)[1], wide = (0.8 * b.w) / (K + 1);
      ctx.fillStyle = ink;
      ctx.fillRect(x - wide / 2, Math.min(y, ground), wide, Math.max(1, Math.abs(ground - y)));
    });
    const range = (low, high) => [-1 - 1 / K, 1 + 1 / K, low, high];

    const policy = toy.pane({
      title: "the policy",
      label: "The probability of each action, and the expert's as a line.",
      help: "Left and right arrow keys choose an action, up and down double and halve its probability.",
      shape: "toy-half",
      ratio: 0.72,
      narrow: 1,
      draw: (ctx, w, h, colour) => {
        const b = box(w, h), high = top();
        const y = (high < 0.5 ? [0, 0.1, 0.2, 0.3, 0.4] : [0, 0.5, 1]).filter((v) => v < high);
        const to = window.toys.axes(ctx, b, range(0, high), colour, {x: [-1, 0, 1], y, xLabel: "action"});
        bars(ctx, b, to, logPi.map(Math.exp), 0, colour.policy);
        window.toys.line(ctx, expert.map((l, k) => to(actions[k], Math.exp(l))), colour.expert, 3);
        if (document.activeElement === policy.canvas)
          window.toys.dot(ctx, ...to(actions[chosen], Math.exp(logPi[chosen])), 6, colour.learner, colour.rim);
      },
      grab: (x, y, ask) => {
        const b = box(policy.w, policy.h);
        const inside = x > b.x && x < b.x + b.w && y > b.y - 8 && y < b.y + b.h + 8;
        if (inside && !ask) aim(x, y);
        return inside;
      },
      drag: aim,
      keys: {
        ArrowLeft: () => { chosen = Math.max(0, chosen - 1); },
        ArrowRight: () => { chosen = Math.min(K - 1, chosen + 1); },
        ArrowUp: () => paint(chosen, 2 * Math.exp(logPi[chosen])),
        ArrowDown: () => paint(chosen, Math.exp(logPi[chosen]) / 2),
        Space: () => step(),
      },
    });

    function aim(x, y) {
      const b = box(policy.w, policy.h), at = ((x - b.x) / b.w) * (2 + 2 / K) - 1 - 1 / K;
      const k = Math.min(K - 1, Math.max(0, Math.round(((at + 1) / 2) * (K - 1))));
      paint(k, top() * (1 - (y - b.y) / b.h));
    }

    toy.pane({
      title: "what it is paid",
      label: "The reward of each action.",
      shape: "toy-half",
      ratio: 0.72,
      narrow: 1,
      draw: (ctx, w, h, colour) => {
        const low = Math.min(-4, ...reward), high = Math.max(4, ...reward), y = [];
        const size = 10 ** Math.floor(Math.log10(high - low));
        const unit = [0.5, 1, 2, 5].map((x) => x * size).find((x) => (high - low) / x < 6);
        for (let v = Math.ceil(low / unit); v * unit <= high; v++) y.push(v * unit);
        const b = box(w, h), to = window.toys.axes(ctx, b, range(low, high), colour,
          {x: [-1, 0, 1], y, xLabel: "action",
            yShow: (v) => (size < 1e4 ? `${v}` : size < 1e6 ? `${v / 1e3}k` : `${v / 1e6}M`).replace("-", "−")});
        bars(ctx, b, to, reward, 0, colour.good);
      },
    });

    toy.pane({
      label: "The spread of the reward, its largest minus its smallest value, by rounds.",
      shape: "toy-full",
      ratio: 0.26,
      narrow: 0.5,
      draw: (ctx, w, h, colour) => {
        const b = {x: 48, y: 24, w: w - 66, h: h - 62};
        const to = window.toys.axes(ctx, b, [0, rounds, -3, 7], colour,
          {x: [0, 3, 6, 9, 12], y: [-3, 0, 3, 6], xLabel: "round", yLabel: "the reward's spread",
            yShow: (v) => ["0.001", "1", "1,000", "10⁶"][v / 3 + 1]});
        const points = story.map((v, k) => to(k, Math.min(7, Math.max(-3, Math.log10(v)))));
        if (points.length) window.toys.line(ctx, points, colour.good, 3);
        points.forEach(([x, y]) => window.toys.dot(ctx, x, y, 4, colour.good));
      },
    });

    const names = Object.entries(REWARDS).map(([key, {name}]) => [key, name]);
    toy.choice("The policy is paid", Object.fromEntries(names), kind,
      (key) => { kind = key; restart(); game.playing = true; });
    toy.slider("temperature α", {min: -3, max: 1, step: 0.1, value: Math.log10(alpha),
      show: (x) => show(10 ** x)}, (x) => { alpha = 10 ** x; restart(); });
    toy.slider("share η of the answer", {min: 0.1, max: 1, step: 0.1, value: share,
      show: (x) => x.toFixed(1)}, (x) => { share = x; restart(); });
    const game = toy.rounds({step, restart, over, pause: 0.25});
    restart();
    return {state: () => ({kind, alpha, share, story, chosen, policy: logPi.map(Math.exp), reward}), finish: game.finish,
      pose: () => { for (let k = 0; k < 5; k++) step(); }};
  }

  window.toys.loop = {expert, paid, round, slope};
  window.toys.definitions.loop = define;
})();
