// Three states between a cliff and a goal: what a constant, added to every step, makes of a life.
(() => {
  const STATES = 3, END = 3, FALLS = 0, ARRIVES = 1, STAYS = 2;
  const LOW = -2.5, HIGH = 1.5, NEAR = 0.5, FAR = 0.98;

  // Values of left, stay and right in each state, by value iteration; every step pays `shift`, and
  // the end pays `end` for ever.
  function actionValues(shift, gamma, end) {
    const v = [0, 0, 0, end / (1 - gamma)], q = [[], [], []];
    for (let change = 1; change > 1e-10;) {
      change = 0;
      for (let s = 0; s < STATES; s++) {
        [-1, 0, 1].forEach((move, a) => {
          const to = s + move < 0 || s + move === STATES ? END : s + move;
          q[s][a] = shift + gamma * v[to] + (to === END ? (move < 0 ? -1 : 1) : 0);
        });
        const best = Math.max(...q[s]);
        change = Math.max(change, Math.abs(best - v[s]));
        v[s] = best;
      }
    }
    return q;
  }

  // What the best policy does from the edge of the cliff.
  function fate(shift, gamma, end) {
    const best = actionValues(shift, gamma, end).map((row) => row.indexOf(Math.max(...row)));
    for (let s = 0, t = 0; t < STATES; t++) {
      s += best[s] - 1;
      if (s < 0) return FALLS;
      if (s === STATES) return ARRIVES;
    }
    return STAYS;
  }

  // The returns of the three lives.
  function returns(shift, gamma, end) {
    const after = (steps) => (gamma ** steps * end) / (1 - gamma);
    return [shift - 1 + after(1), shift * (1 + gamma + gamma ** 2) + gamma ** 2 + after(3),
      shift / (1 - gamma)];
  }

  const WORDS = ["falls at once", "walks to the goal", "never ends"];

  function define(toy) {
    let gamma = 0.9, shift = 0, own = false, clock = 0, map = null;
    const wide = 49, high = 61, raster = window.toys.raster(wide, high);
    const end = (c) => (own ? c : 0);
    const number = (x, digits = 1) => x.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");

    function survey() {
      map = [];
      for (let i = 0; i < wide * high; i++) {
        const g = NEAR + ((FAR - NEAR) * (i % wide)) / (wide - 1);
        const c = HIGH - ((HIGH - LOW) * (Math.floor(i / wide) + 0.5)) / high;
        map.push(fate(c, g, end(c)));
      }
    }

    function tell() {
      const [fall, walk, stay] = returns(shift, gamma, end(shift)).map((x) => number(x));
      toy.say(`Constant ${number(shift, 2)}, discount ${number(gamma, 2)}: the agent `
        + `${WORDS[fate(shift, gamma, end(shift))]}. Falling ${fall}, walking ${walk}, `
        + `never ending ${stay}.`);
    }

    function set(g, c) {
      gamma = Math.min(FAR, Math.max(NEAR, g));
      shift = Math.min(HIGH, Math.max(LOW, c));
      discount.set(gamma);
      constant.set(shift);
      if (window.toys.calm()) clock = 10;
      tell();
    }

    toy.pane({
      label: "A cliff, three squares and a goal, with an agent that does what is best.",
      shape: "toy-full",
      ratio: 0.17,
      narrow: 0.3,
      draw: (ctx, w, h, colour) => {
        const size = Math.min(w / 6.2, 1.3 * h), left = (w - 5 * size) / 2, ground = h - 14;
        const at = (i) => left + (i + 0.5) * size, life = fate(shift, gamma, end(shift));
        ctx.fillStyle = colour.reward[1];
        ctx.fillRect(left + size, ground, 3 * size, 14);
        ctx.fillStyle = colour.good;
        ctx.fillRect(left + 4 * size, ground, size, 14);
        window.toys.line(ctx, [[left + size, ground], [left + 5 * size, ground]], colour.ink, 3);
        window.toys.line(ctx, [[left + size, ground], [left + 0.9 * size, h]], colour.wall, 4);
        const look = {size: 13, colour: colour.soft};
        window.toys.text(ctx, "cliff: −1", at(0), 16, {...look, colour: colour.wall});
        window.toys.text(ctx, "goal: +1", at(4), 16, {...look, colour: colour.good});
        window.toys.star(ctx, at(4), ground - 14, 12, colour.star, colour.rim);
        const t = window.toys.calm() ? 10 : clock % 3.2, radius = Math.min(17, size / 4);
        let [x, y, turn] = [at(1), ground - radius, [0, 0]];
        if (life === FALLS) {
          x = at(1) - size * Math.min(1, t * 1.6);
          const drop = Math.max(0, t * 1.6 - 0.6);
          y += window.toys.calm() ? 4 : h * drop * drop;
          turn = [-1, -1];
        } else if (life === ARRIVES) {
          const gone = Math.min(3, t * 1.6);
          x = at(1) + size * gone;
          y -= 10 * Math.abs(Math.sin(gone * Math.PI));
          turn = [1, 0];
        } else if (!window.toys.calm()) y -= 14 * Math.abs(Math.sin(clock * 5));
        window.toys.mazes.walker(ctx, x, y, radius, colour.learner, colour, turn);
      },
    });

    const box = (w, h) => ({x: 44, y: 24, w: w - 58, h: h - 66});
    const pane = toy.pane({
      label: "A map of what is best, over the discount and the constant.",
      help: "Arrow keys move the point.",
      shape: "toy-full",
      ratio: 0.5,
      narrow: 0.85,
      draw: (ctx, w, h, colour) => {
        const b = box(w, h), paints = [colour.wall, colour.reward[2], colour.copy];
        raster.colours((i) => paints[map[i]], colour, map);
        raster.draw(ctx, b, false);
        const to = window.toys.axes(ctx, b, [NEAR, FAR, LOW, HIGH], {...colour, line: "transparent"},
          {x: [0.5, 0.6, 0.7, 0.8, 0.9], y: [-2, -1, 0, 1], xLabel: "discount γ",
            yLabel: "constant c, added to every step"});
        for (const [k, c] of [[STAYS, 1.15], [ARRIVES, -0.35], [FALLS, -2.1]])
          if (map.includes(k)) window.toys.text(ctx, WORDS[k], ...to(0.72, c),
            {size: 15, colour: k === ARRIVES ? colour.ink : colour.card, weight: 700});
        const [x, y] = to(gamma, shift);
        window.toys.dot(ctx, x, y, 11, colour.learner, colour.rim, 2.5);
      },
      grab: (x, y, ask) => {
        const b = box(pane.w, pane.h);
        const inside = x > b.x - 12 && x < b.x + b.w + 12 && y > b.y - 12 && y < b.y + b.h + 12;
        if (inside && !ask) aim(x, y);
        return inside;
      },
      drag: aim,
      keys: window.toys.arrowKeys((dx, dy) => set(gamma + 0.01 * dx, shift + 0.05 * dy)),
    });

    function aim(x, y) {
      const b = box(pane.w, pane.h);
      set(NEAR + ((FAR - NEAR) * (x - b.x)) / b.w, HIGH - ((HIGH - LOW) * (y - b.y)) / b.h);
    }

    toy.choice("The end is worth", {nothing: "nothing", own: "c, for ever"}, "nothing", (key) => {
      own = key === "own";
      survey();
      tell();
    });
    const show = (x) => number(x, 2);
    const constant = toy.slider("constant c", {min: LOW, max: HIGH, step: 0.01, value: shift, show},
      (x) => set(gamma, x));
    const discount = toy.slider("discount γ", {min: NEAR, max: FAR, step: 0.01, value: gamma, show},
      (x) => set(x, shift));
    survey();
    tell();
    toy.play((passed) => {
      if (window.toys.calm()) return undefined;
      clock += passed;
      return true;
    });
    return {state: () => ({gamma, shift, own}), pose: () => set(0.9, 0.6)};
  }

  window.toys.life = {actionValues, fate, returns};
  window.toys.definitions.life = define;
})();
