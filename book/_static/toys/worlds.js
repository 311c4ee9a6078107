// Chapter 12: films of one expert in two worlds, the smallest reward that explains both, and a plan
// on it in a new maze. Everything is solved exactly.
(() => {
  const {A, build, book, solve, visits, score, walk, likeliest, board, movable, ...paint} = window.toys.mazes;
  const n = 12, S = n * n, alpha = 0.05;
  const CONTROLS = {same: [0, 1, 2, 3, 4], turned: [0, 2, 3, 4, 1], mirrored: [0, 3, 2, 1, 4]};
  const LEFT = book(n, "Left"), initial = new Float64Array(S);
  initial[LEFT.start] = 1;
  const dot = (x, y) => x.reduce((sum, v, i) => sum + v * y[i], 0);

  // A world: where each button leads, and the share `slip` of commands that are replaced at random.
  function world({wall, controls = "same", slip = 0, gamma = 0.97}) {
    const plain = build(n, wall);
    return {to: plain.map((_, i) => plain[i - (i % A) + CONTROLS[controls][i % A]]), slip, gamma};
  }

  // The maze with a wall below a row, open in two columns.
  function doored({row, door}) {
    const parts = [{row, from: 0, to: door}, {row, from: door + 2, to: n}].map((wall) => build(n, wall));
    const to = parts[0].map((t, i) => (parts[1][i] === Math.floor(i / A) ? parts[1][i] : t));
    return {to, slip: 0, gamma: 0.97};
  }

  // (γP - E)Φ, the shaping of a potential, and the transposed matrix times a reward.
  function shape({to, slip, gamma}, phi) {
    const out = new Float64Array(S * A);
    for (let s = 0; s < S; s++) {
      let drift = 0;
      for (let i = s * A; i < s * A + A; i++) drift += phi[to[i]] / A;
      for (let i = s * A; i < s * A + A; i++)
        out[i] = gamma * ((1 - slip) * phi[to[i]] + slip * drift) - phi[s];
    }
    return out;
  }

  function unshape({to, slip, gamma}, r) {
    const out = new Float64Array(S);
    for (let s = 0; s < S; s++) {
      let all = 0;
      for (let i = s * A; i < s * A + A; i++) all += r[i];
      out[s] -= all;
      for (let i = s * A; i < s * A + A; i++)
        out[to[i]] += gamma * ((1 - slip) * r[i] + (slip * all) / A);
    }
    return out;
  }

  // log π of the soft-optimal policy.
  function plan({to, slip, gamma}, reward) {
    const {q, value} = solve(to, reward, alpha, gamma, {slip});
    return q.map((x, i) => (x - value[Math.floor(i / A)]) / alpha);
  }

  // What a world shows of a reward: all but the nearest shaping.
  function viewer(place) {
    const low = [...Array(S).keys()].map((j) => {
      const one = new Float64Array(S);
      one[j] = 1;
      return unshape(place, shape(place, one));
    });
    for (let j = 0; j < S; j++) for (let i = j; i < S; i++) { // Cholesky
      let sum = low[i][j];
      for (let k = 0; k < j; k++) sum -= low[i][k] * low[j][k];
      low[i][j] = i === j ? Math.sqrt(sum) : sum / low[j][j];
    }
    return (r) => {
      const x = unshape(place, r);
      for (let i = 0; i < S; i++) {
        for (let k = 0; k < i; k++) x[i] -= low[i][k] * x[k];
        x[i] /= low[i][i];
      }
      for (let i = S - 1; i >= 0; i--) {
        for (let k = i + 1; k < S; k++) x[i] -= low[k][i] * x[k];
        x[i] /= low[i][i];
      }
      const nearest = shape(place, x);
      return r.map((v, i) => v - nearest[i]);
    };
  }

  // The smallest reward that explains all films, by conjugate gradients from 0.
  function learn(views, films) {
    const see = (r) => {
      const parts = views.map((view) => view(r));
      return r.map((_, i) => parts.reduce((sum, part) => sum + part[i], 0));
    };
    let r = new Float64Array(S * A), left = new Float64Array(S * A);
    views.forEach((view, k) => view(films[k].map((x) => alpha * x)).forEach((v, i) => { left[i] += v; }));
    let way = left, size = dot(left, left);
    const enough = 1e-22 * size;
    for (let k = 0; k < 2000 && size > enough; k++) {
      const seen = see(way), step = size / dot(way, seen);
      r = r.map((v, i) => v + step * way[i]);
      left = left.map((v, i) => v - step * seen[i]);
      const before = size;
      size = dot(left, left);
      way = left.map((v, i) => v + (size / before) * way[i]);
    }
    return r;
  }

  // In how many directions a shaping of the first world is one of all: those that Cholesky's
  // factors, the largest pivot first, leave at 0.
  function open(places, views) {
    const m = [...Array(S).keys()].map((j) => {
      const one = new Float64Array(S), sum = new Float64Array(S);
      one[j] = 1;
      const shaping = shape(places[0], one);
      for (const view of views.slice(1)) unshape(places[0], view(shaping)).forEach((v, i) => { sum[i] += v; });
      return sum;
    });
    let rest = [...m.keys()];
    while (rest.length) {
      const k = rest.reduce((a, b) => (m[b][b] > m[a][a] ? b : a));
      if (m[k][k] < 1e-9) break;
      rest = rest.filter((i) => i !== k);
      for (const i of rest) {
        const share = m[i][k] / m[k][k];
        for (const j of rest) m[i][j] -= share * m[k][j];
      }
    }
    return rest.length;
  }

  function centred(x) {
    const mean = x.reduce((a, b) => a + b) / x.length;
    return x.map((v) => v - mean);
  }
  const covariance = (x, y) => dot(centred(x), centred(y)) / x.length;
  const deviation = (x) => Math.sqrt(covariance(x, x));

  const truth = Float64Array.from({length: S * A}, (_, i) => LEFT.reward[Math.floor(i / A)]);
  const first = world({wall: LEFT.wall}), likely = (film) => film.map(Math.exp);

  // What the first world and a second one teach for a new maze. `noise` (S·A) chooses among the
  // rewards that explain the films: what no film shows of it is added to the smallest.
  function lesson(second, fresh, noise) {
    const places = [first, second];
    const films = places.map((place) => plan(place, truth)), views = places.map(viewer);
    let reward = learn(views, films);
    if (noise) {
      const shown = learn(views, films.map(() => noise.map((x) => x / alpha)));
      const extra = noise.map((x, i) => x - shown[i]), size = Math.max(1e-3, deviation(extra));
      reward = reward.map((x, i) => x + (deviation(truth) * extra[i]) / size);
    }
    const own = plan(fresh, reward);
    const [copied, best, found] = [films[0], plan(fresh, truth), own].map((film) =>
      score(visits(fresh.to, likely(film), initial, fresh.gamma), likely(film), truth));
    return {films, reward, own, open: open(places, views), score: (found - copied) / (best - copied),
      like: covariance(reward, truth) / (deviation(reward) * deviation(truth))};
  }

  function define(toy) {
    const SAME = {controls: "same", slip: 0, gamma: 0.97}, fresh = {row: LEFT.wall.row, door: 1};
    let change = {...SAME}, noise = null, now, held = null;
    const hand = movable(n, LEFT.wall, look);

    function look() {
      const place = doored(fresh);
      const second = world({...change, wall: hand.wall});
      now = lesson(second, place, noise);
      now.ways = [[first, now.films[0]], [second, now.films[1]], [place, now.own]]
        .map(([{to}, film]) => walk(to, likeliest(likely(film)), LEFT.start));
      const directions = now.open === 1 ? "only a constant" : `${now.open} directions`;
      toy.say(`The films leave ${directions} open. This reward correlates with the true one at `
        + `${now.like.toFixed(2).replace("-", "−")}. Its plan in the new maze scores `
        + `${`${Math.round(100 * now.score)}`.replace("-", "−")} %.`);
    }

    function draw(ctx, b, k, colour, fill) {
      const route = now.ways[k], line = route.map(b.centre), last = route.length - 1;
      fill();
      window.toys.line(ctx, line, colour.card, 7);
      window.toys.line(ctx, line, k < 2 ? colour.expert : colour.learner, 4);
      window.toys.star(ctx, ...b.centre(LEFT.goal), Math.max(12, 0.8 * b.size), colour.star, colour.rim);
      paint.walker(ctx, ...line[last], Math.max(6, 0.4 * b.size),
        k < 2 ? colour.expert : colour.learner, colour);
    }
    const span = [Math.min(...LEFT.reward), Math.max(...LEFT.reward)];
    const hill = (ctx, b, colour) => paint.squares(ctx, b, (s) => window.toys.shade(colour.reward,
      (LEFT.reward[s] - span[0]) / (span[1] - span[0])), colour);

    toy.pane({title: "the first film", label: "The expert's way round the wall to the star.", shape: "toy-half",
      scale: ["low reward", "high"],
      draw: (ctx, w, h, colour) => {
        const b = board(n, w);
        draw(ctx, b, 0, colour, () => { hill(ctx, b, colour); paint.wall(ctx, b, LEFT.wall, colour); });
      }});
    const left = toy.pane({
      title: "the second film",
      label: "The same expert in another world.",
      help: "Arrow keys move its wall.",
      scale: ["low reward", "high"],
      shape: "toy-half",
      draw: (ctx, w, h, colour) => {
        const b = board(n, w);
        draw(ctx, b, 1, colour, () => {
          hill(ctx, b, colour);
          ctx.save();
          ctx.globalAlpha = 0.15 + 0.5 * change.slip;
          for (let s = 0; s < S; s++) { // Drops, as many as commands fail.
            const [x, y] = b.centre(s);
            if ((s * 37) % 101 < 101 * change.slip) window.toys.dot(ctx, x, y, 0.32 * b.size, colour.copy);
          }
          ctx.restore();
          hand.draw(ctx, b, colour);
        });
      },
      grab: (x, y, ask) => {
        const b = board(n, left.w), hit = hand.hit(b, x, y);
        if (hit && !ask) hand.grab(b, x, y);
        return hit;
      },
      drag: (x, y) => hand.drag(board(n, left.w), x, y),
      drop: hand.drop,
      keys: window.toys.arrowKeys((dx, dy) => hand.move({from: hand.wall.from + dx, row: hand.wall.row + dy})),
    });

    function shift(row, door) {
      const limit = (x, low, high) => Math.min(high, Math.max(low, x));
      [row, door] = [limit(row, 1, n - 1), limit(door, 0, n - 2)];
      if (row === fresh.row && door === fresh.door) return;
      Object.assign(fresh, {row, door});
      look();
    }
    const right = toy.pane({
      title: "a new maze",
      label: "A maze with a door, coloured by the learned reward of each move, and the way planned on it.",
      help: "Arrow keys move its wall and its door.",
      scale: ["low reward", "high"],
      draw: (ctx, w, h, colour) => {
        const b = board(n, w), low = Math.min(...now.reward), high = Math.max(...now.reward);
        draw(ctx, b, 2, colour, () => {
          paint.squares(ctx, b, () => colour.floor, colour);
          paint.triangles(ctx, b, (i) =>
            window.toys.shade(colour.reward, (now.reward[i] - low) / (high - low)));
          for (const [from, to] of [[0, fresh.door], [fresh.door + 2, n]])
            if (from < to) paint.wall(ctx, b, {row: fresh.row, from, to}, colour);
        });
      },
      grab: (x, y, ask) => {
        const b = board(n, right.w), hit = Math.abs(y - b.row(fresh.row)) < 20;
        if (hit && !ask) held = {x, y, ...fresh};
        return hit;
      },
      drag: (x, y) => {
        const {size} = board(n, right.w);
        shift(held.row - Math.round((y - held.y) / size), held.door + Math.round((x - held.x) / size));
      },
      keys: window.toys.arrowKeys((dx, dy) => shift(fresh.row + dy, fresh.door + dx)),
    });

    const set = (part) => { Object.assign(change, part); noise = null; look(); };
    const wet = toy.slider("commands that fail", {min: 0, max: 1, step: 0.05, value: 0,
      show: (x) => `${Math.round(100 * x)} %`}, (slip) => set({slip}));
    const controls = toy.choice("Controls", {same: "as before", turned: "turned by 90°", mirrored: "mirrored"},
      "same", (key) => set({controls: key}));
    const haste = toy.choice("Expert", {0.97: "patient", 0.9: "in a hurry"}, "0.97",
      (key) => set({gamma: +key}));
    const again = () => {
      wet.set(0);
      controls.set("same");
      haste.set("0.97");
      hand.wall = {...LEFT.wall};
      set(SAME);
    };
    toy.button("Another reward that fits", () => {
      noise = Float64Array.from({length: S * A}, () => Math.random() + Math.random() - 1);
      look();
    }, {strong: true});
    toy.button("The same film again", again);
    look();
    return {state: () => ({change, wall: hand.wall, fresh, open: now.open, like: now.like, score: now.score}),
      pose: () => { wet.set(0.3); set({slip: 0.3}); }};
  }

  window.toys.worlds = {world, doored, lesson};
  window.toys.definitions.worlds = define;
})();
