// Grid mazes, solved exactly: the mathematics that several toys share.
// States are squares, row by row from the bottom; the actions are stay, right, up, left, down.
(() => {
  const MOVES = [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]];
  const A = MOVES.length;

  // Where every action leads, (S·A). A wall lies below `row`, over the columns from `from` to `to`.
  function build(n, wall) {
    const to = new Int32Array(n * n * A);
    const limit = (i) => Math.min(n - 1, Math.max(0, i));
    for (let s = 0; s < n * n; s++) {
      const row = Math.floor(s / n), column = s % n;
      MOVES.forEach(([dx, dy], a) => {
        const r = limit(row + dy);
        const blocked = wall && r !== row && Math.max(r, row) === wall.row
          && column >= wall.from && column < wall.to;
        to[s * A + a] = blocked ? s : r * n + limit(column + dx);
      });
    }
    return to;
  }

  // The book's two mazes, cut into n × n squares; lengths in metres.
  const LOW = -0.1, HIGH = 0.6;
  function book(n, side) {
    const size = (HIGH - LOW) / n;
    const centre = (i) => LOW + size * (i + 0.5);
    const after = (x) => [...Array(n).keys()].filter((i) => centre(i) <= x).length;
    const wall = side === "Left"
      ? {row: after(0.3), from: 0, to: after(0.4)}
      : {row: after(0.3), from: after(0.2), to: n};
    const nearest = (x, y) => {
      let best = 0, least = Infinity;
      for (let s = 0; s < n * n; s++) {
        const far = Math.hypot(centre(s % n) - x, centre(Math.floor(s / n)) - y);
        if (far < least - 1e-12) [best, least] = [s, far];
      }
      return best;
    };
    const reward = Float64Array.from({length: n * n}, (_, s) =>
      -Math.hypot(centre(s % n) - 0.3, centre(Math.floor(s / n)) - 0.5));
    return {wall, start: nearest(0.3, 0), goal: nearest(0.3, 0.5), reward};
  }

  // I - γP of a policy as L·U. A row's entries are at most n away from the diagonal, so that the
  // factors have the same band, and none is so small that rows would have to be exchanged.
  function factors(to, policy, gamma) {
    const S = to.length / A, n = Math.round(Math.sqrt(S)), wide = 2 * n + 1;
    const m = new Float64Array(S * wide);
    for (let s = 0; s < S; s++) {
      m[s * wide + n] = 1;
      for (let i = s * A; i < s * A + A; i++) m[s * wide + n + to[i] - s] -= gamma * policy[i];
    }
    for (let k = 0; k < S; k++) {
      const pivot = k * wide + n, end = Math.min(S - 1, k + n);
      for (let i = k + 1; i <= end; i++) {
        const row = i * wide + n - i, l = (m[row + k] /= m[pivot]);
        if (l) for (let j = k + 1; j <= end; j++) m[row + j] -= l * m[pivot - k + j];
      }
    }
    const at = (i, j) => m[i * wide + n - i + j];
    const forward = (x, entry, divide) => {
      for (let i = 0; i < S; i++) {
        for (let j = Math.max(0, i - n); j < i; j++) x[i] -= entry(i, j) * x[j];
        if (divide) x[i] /= at(i, i);
      }
      return x;
    };
    const backward = (x, entry, divide) => {
      for (let i = S - 1; i >= 0; i--) {
        for (let j = Math.min(S - 1, i + n); j > i; j--) x[i] -= entry(i, j) * x[j];
        if (divide) x[i] /= at(i, i);
      }
      return x;
    };
    const turned = (i, j) => at(j, i);
    return {
      solve: (x) => backward(forward(Float64Array.from(x), at), at, true),
      solveTransposed: (x) => backward(forward(Float64Array.from(x), turned, true), turned),
    };
  }

  // The soft-optimal policy of a reward (S) or (S·A): π = exp((Q - V)/α), in `policy` (S·A), by
  // soft policy iteration. At a temperature α of 0 it takes one of the best actions. A share `slip`
  // of the actions is replaced by one of all, drawn at random.
  function solve(to, reward, alpha, gamma, {guess, tolerance = 1e-11, sweeps = 200, slip = 0} = {}) {
    const S = to.length / A, ofState = reward.length === S;
    const q = new Float64Array(S * A), policy = new Float64Array(S * A), moves = new Float64Array(S * A);
    const gain = new Float64Array(S), better = new Float64Array(S);
    let value = guess || new Float64Array(S);
    for (let sweep = 0; ; sweep++) {
      let change = 0, size = 0;
      for (let s = 0; s < S; s++) {
        let best = -Infinity, total = 0, first = -1, drift = 0;
        for (let i = s * A; i < s * A + A; i++) drift += (slip / A) * value[to[i]];
        for (let i = s * A; i < s * A + A; i++) {
          q[i] = (ofState ? reward[s] : reward[i]) + gamma * ((1 - slip) * value[to[i]] + drift);
          if (q[i] > best + 1e-12) [best, first] = [q[i], i];
        }
        for (let i = s * A; i < s * A + A; i++)
          total += policy[i] = alpha > 0 ? Math.exp((q[i] - best) / alpha) : +(i === first);
        better[s] = best + (alpha > 0 ? alpha * Math.log(total) : 0);
        gain[s] = better[s];
        for (let i = s * A; i < s * A + A; i++) {
          policy[i] /= total;
          moves[i] = (1 - slip) * policy[i] + slip / A;
          gain[s] -= moves[i] * gamma * value[to[i]]; // Σ π (r - α log π)
        }
        change = Math.max(change, Math.abs(better[s] - value[s]));
        size = Math.max(size, Math.abs(better[s]));
      }
      if (change <= tolerance * size || sweep === sweeps) return {value: better, q, policy};
      value = factors(to, moves, gamma).solve(gain);
    }
  }

  // The discounted visits of a policy to each square, (S); they add up to 1 / (1 - γ).
  const visits = (to, policy, initial, gamma) =>
    factors(to, policy, gamma).solveTransposed(initial);

  // The return of a reward from the visits, without the entropy's bonus.
  function score(d, policy, reward) {
    let sum = 0;
    const ofState = reward.length === d.length;
    for (let i = 0; i < policy.length; i++) {
      const s = Math.floor(i / A);
      sum += d[s] * policy[i] * (ofState ? reward[s] : reward[i]);
    }
    return sum;
  }

  // Maximum entropy IRL by L-BFGS, from a reward of 0: each step yields a reward of the state (S)
  // or of the pair (S·A). `seen` are the expert's visits (S·A).
  function* maxent(to, seen, initial, alpha, gamma, ofState) {
    const S = to.length / A, size = ofState ? S : S * A, memory = [];
    let guess;
    const loss = (x) => {
      const {value, policy} = solve(to, x, alpha, gamma, {guess});
      const d = visits(to, policy, initial, gamma), slope = new Float64Array(size);
      let sum = 0;
      for (let s = 0; s < S; s++) sum += (initial[s] * value[s]) / alpha;
      for (let i = 0; i < S * A; i++) {
        const s = Math.floor(i / A), k = ofState ? s : i;
        sum -= (seen[i] * x[k]) / alpha;
        slope[k] += (d[s] * policy[i] - seen[i]) / alpha;
      }
      guess = value;
      return {sum, slope};
    };
    const dot = (a, b) => a.reduce((total, v, i) => total + v * b[i], 0);
    let x = new Float64Array(size), {sum, slope} = loss(x);
    for (;;) {
      yield x;
      const way = slope.map((v) => -v), held = [];
      for (const {s, y, rho} of [...memory].reverse()) {
        const a = rho * dot(s, way);
        held.push(a);
        y.forEach((v, i) => { way[i] -= a * v; });
      }
      if (memory.length) {
        const {y, rho} = memory[memory.length - 1], scale = 1 / (rho * dot(y, y));
        way.forEach((v, i) => { way[i] = v * scale; });
      }
      for (const {s, y, rho} of memory) {
        const b = held.pop() - rho * dot(y, way);
        s.forEach((v, i) => { way[i] += b * v; });
      }
      const fall = dot(slope, way);
      let step = memory.length ? 1 : 1 / Math.sqrt(dot(slope, slope)), next, found;
      for (let tries = 0; tries < 20; tries++, step /= 2) {
        next = x.map((v, i) => v + step * way[i]);
        found = loss(next);
        if (found.sum <= sum + 1e-4 * step * fall) break;
      }
      const s = next.map((v, i) => v - x[i]), y = found.slope.map((v, i) => v - slope[i]);
      const along = dot(s, y);
      if (along > 1e-14) memory.push({s, y, rho: 1 / along});
      if (memory.length > 20) memory.shift();
      [x, {sum, slope}] = [next, found];
    }
  }

  // The squares on the way of the most probable actions, until one comes again.
  function walk(to, choose, start, steps = 400) {
    const way = [start], seen = new Set(way);
    for (let t = 0, s = start; t < steps; t++) {
      s = to[s * A + choose(s)];
      way.push(s);
      if (seen.has(s)) break;
      seen.add(s);
    }
    return way;
  }

  function likeliest(policy) {
    return (s) => {
      let best = 0;
      for (let a = 1; a < A; a++) if (policy[s * A + a] > policy[s * A + best]) best = a;
      return best;
    };
  }

  // A maze on a canvas: a square of `side` pixels, whose corner is at (x, y).
  function board(n, side, x = 0, y = 0) {
    const pad = 7, size = (side - 2 * pad) / n;
    const column = (c) => x + pad + c * size, row = (r) => y + side - pad - r * size;
    const centre = (s) => [column((s % n) + 0.5), row(Math.floor(s / n) + 0.5)];
    const at = (px, py) => {
      const limit = (v) => Math.min(n - 1, Math.max(0, Math.floor(v)));
      return limit((y + side - pad - py) / size) * n + limit((px - x - pad) / size);
    };
    return {n, side, x, y, pad, size, column, row, centre, at};
  }

  // The squares in the colours of `fill(s)`, and the border round them.
  function squares(ctx, b, fill, colour) {
    for (let s = 0; s < b.n ** 2; s++) {
      ctx.fillStyle = fill(s); // A little larger, so that no seam shows.
      ctx.fillRect(b.column(s % b.n), b.row(Math.floor(s / b.n) + 1) - 0.6, b.size + 0.6,
        b.size + 0.6);
    }
    ctx.lineWidth = 5;
    ctx.lineJoin = "round";
    ctx.strokeStyle = colour.frame;
    ctx.strokeRect(b.x + b.pad - 2.5, b.y + b.pad - 2.5, b.side - 2 * b.pad + 5,
      b.side - 2 * b.pad + 5);
  }

  // A reward of the pair: a triangle for each move, and in the middle staying.
  function triangles(ctx, b, fill) {
    const half = b.size / 2;
    for (let s = 0; s < b.n ** 2; s++) {
      const [x, y] = b.centre(s);
      MOVES.forEach(([dx, dy], a) => {
        ctx.fillStyle = fill(s * A + a);
        if (!a) return;
        ctx.beginPath();
        ctx.moveTo(x, y);
        for (const side of [-1, 1])
          ctx.lineTo(x + half * (dx + side * dy), y - half * (dy - side * dx));
        ctx.fill();
      });
      ctx.fillStyle = fill(s * A);
      ctx.fillRect(x - half / 3, y - half / 3, (2 * half) / 3, (2 * half) / 3);
    }
  }

  // The mean moves of a policy, on every second square of every second row.
  function arrows(ctx, b, policy, colour) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(b.x + b.pad, b.y + b.pad, b.side - 2 * b.pad, b.side - 2 * b.pad);
    ctx.clip();
    for (let s = 0; s < b.n ** 2; s++) {
      if (s % 2 || Math.floor(s / b.n) % 2) continue;
      let [u, v] = [0, 0];
      MOVES.forEach(([dx, dy], a) => {
        u += dx * policy[s * A + a];
        v += dy * policy[s * A + a];
      });
      if (Math.hypot(u, v) < 0.15) continue;
      const [x, y] = b.centre(s), far = 0.8 * b.size;
      window.toys.arrow(ctx, [x - far * u, y + far * v], [x + far * u, y - far * v], colour,
        Math.max(1, b.size / 11), Math.max(3, b.size / 4));
    }
    ctx.restore();
  }

  function wall(ctx, b, {row, from, to}, colour, {ghost = false} = {}) {
    const ends = [Math.max(0, from), Math.min(b.n, to)].map((c) => [b.column(c), b.row(row)]);
    if (ghost) return window.toys.line(ctx, ends, colour.soft, 2, {dash: [2, 6]});
    window.toys.line(ctx, ends, colour.card, 11);
    window.toys.line(ctx, ends, colour.wall, 7);
  }

  // A wall that a hand can move, by its knob or anywhere; `changed` is called when it has moved.
  function movable(n, first, changed) {
    let held = null;
    const hand = {wall: {...first}};
    const ends = (b) => [Math.max(0, hand.wall.from), Math.min(n, hand.wall.to)].map(b.column);
    const knob = (b) => [(ends(b)[0] + ends(b)[1]) / 2, b.row(hand.wall.row)];
    hand.move = (change) => {
      const long = hand.wall.to - hand.wall.from, next = {...hand.wall, ...change};
      const from = Math.min(n - 4, Math.max(4 - long, next.from));
      const row = Math.min(n - 1, Math.max(1, next.row));
      if (from === hand.wall.from && row === hand.wall.row) return;
      hand.wall = {row, from, to: from + long};
      changed();
    };
    hand.hit = (b, x, y) => Math.abs(y - b.row(hand.wall.row)) < 20
      && x > ends(b)[0] - 12 && x < ends(b)[1] + 12;
    hand.grab = (b, x, y) => { held = {x, y, ...hand.wall}; };
    hand.holds = () => held !== null;
    hand.drop = () => { held = null; };
    hand.drag = (b, x, y) => hand.move({
      from: held.from + Math.round((x - held.x) / b.size),
      row: held.row - Math.round((y - held.y) / b.size),
    });
    hand.draw = (ctx, b, colour, pulse = 0) => {
      const [x, y] = knob(b);
      wall(ctx, b, hand.wall, colour);
      if (pulse) window.toys.dot(ctx, x, y, 14 + pulse, `${colour.wall}55`);
      window.toys.dot(ctx, x, y, 13, colour.wall, colour.card, 2.5);
      for (const [dx, dy] of MOVES.slice(1)) {
        ctx.beginPath();
        for (const [far, side] of [[9, 0], [5, 3], [5, -3]])
          ctx.lineTo(x + far * dx + side * dy, y - far * dy + side * dx);
        ctx.fillStyle = colour.card;
        ctx.fill();
      }
    };
    return hand;
  }

  // A somebody with eyes that look where it goes.
  function walker(ctx, x, y, radius, fill, colour, [dx, dy] = [0, 0]) {
    window.toys.dot(ctx, x, y, radius, fill, colour.rim, 1.5);
    for (const side of [-1, 1]) {
      const u = x + side * 0.38 * radius + 0.2 * radius * dx, v = y - 0.12 * radius - 0.2 * radius * dy;
      window.toys.dot(ctx, u, v, 0.27 * radius, "#fff");
      window.toys.dot(ctx, u + 0.1 * radius * dx, v - 0.1 * radius * dy, 0.14 * radius, "#17142b");
    }
  }

  window.toys.mazes = {MOVES, A, build, book, solve, visits, maxent, score, walk, likeliest, board, squares,
    triangles, arrows, wall, movable, walker};
})();
