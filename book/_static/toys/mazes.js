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

  // The soft-optimal policy of a reward (S) or (S·A): π = exp((Q - V)/α), in `policy` (S·A).
  // At a temperature α of 0 it takes one of the best actions.
  function solve(to, reward, alpha, gamma, {guess, tolerance = 1e-9, sweeps = 5000} = {}) {
    const S = to.length / A, ofState = reward.length === S;
    const value = Float64Array.from(guess || new Float64Array(S));
    const q = new Float64Array(S * A), policy = new Float64Array(S * A);
    for (let sweep = 0; sweep < sweeps; sweep++) {
      let change = 0;
      for (let s = 0; s < S; s++) {
        let best = -Infinity, total = 0;
        for (let i = s * A; i < s * A + A; i++) {
          q[i] = (ofState ? reward[s] : reward[i]) + gamma * value[to[i]];
          if (q[i] > best) best = q[i];
        }
        if (alpha > 0) {
          for (let i = s * A; i < s * A + A; i++) total += Math.exp((q[i] - best) / alpha);
          best += alpha * Math.log(total);
        }
        change = Math.max(change, Math.abs(best - value[s]));
        value[s] = best; // Later squares already see it.
      }
      if (change < tolerance) break;
    }
    for (let s = 0; s < S; s++) {
      const row = q.subarray(s * A, s * A + A);
      if (alpha > 0) {
        let best = Math.max(...row), total = 0;
        for (let a = 0; a < A; a++) total += policy[s * A + a] = Math.exp((row[a] - best) / alpha);
        for (let a = 0; a < A; a++) policy[s * A + a] /= total;
      } else policy[s * A + row.indexOf(Math.max(...row))] = 1;
    }
    return {value, q, policy};
  }

  // The discounted visits of a policy to each square, (S); they add up to 1 / (1 - γ).
  function visits(to, policy, initial, gamma, {guess, tolerance = 1e-9, sweeps = 5000} = {}) {
    const S = to.length / A;
    let d = Float64Array.from(guess || initial);
    for (let sweep = 0; sweep < sweeps; sweep++) {
      const next = Float64Array.from(initial);
      for (let i = 0; i < S * A; i++) {
        const flow = policy[i] * d[Math.floor(i / A)];
        if (flow) next[to[i]] += gamma * flow;
      }
      let change = 0;
      for (let s = 0; s < S; s++) change = Math.max(change, Math.abs(next[s] - d[s]));
      d = next;
      if (change < tolerance) break;
    }
    return d;
  }

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
    const edge = (v) => Math.round(v * 2) / 2;
    for (let s = 0; s < b.n ** 2; s++) {
      const left = edge(b.column(s % b.n)), top = edge(b.row(Math.floor(s / b.n) + 1));
      ctx.fillStyle = fill(s);
      ctx.fillRect(left, top, edge(b.column((s % b.n) + 1)) - left,
        edge(b.row(Math.floor(s / b.n))) - top);
    }
    ctx.lineWidth = 5;
    ctx.lineJoin = "round";
    ctx.strokeStyle = colour.ink;
    ctx.strokeRect(b.x + b.pad - 2.5, b.y + b.pad - 2.5, b.side - 2 * b.pad + 5,
      b.side - 2 * b.pad + 5);
  }

  function wall(ctx, b, {row, from, to}, colour, {ghost = false} = {}) {
    const ends = [Math.max(0, from), Math.min(b.n, to)].map((c) => [b.column(c), b.row(row)]);
    if (ghost) return window.toys.line(ctx, ends, colour.soft, 2, {dash: [2, 6]});
    window.toys.line(ctx, ends, colour.card, 11);
    window.toys.line(ctx, ends, colour.wall, 7);
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

  window.toys.mazes = {MOVES, A, build, book, solve, visits, score, walk, likeliest, board, squares,
    wall, walker};
})();
