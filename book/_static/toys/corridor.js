// The game of imitation in a corridor of seven rooms with a door behind the last, solved exactly.
(() => {
  const ROOMS = 7, gamma = 0.95, rounds = 150, count = 18;
  const softplus = (x) => Math.max(x, 0) + Math.log1p(Math.exp(-Math.abs(x)));
  const REWARDS = {
    survive: {name: "−log(1 − D)", of: softplus},
    leave: {name: "log D", of: (l) => -softplus(-l)},
    logit: {name: "log D − log(1 − D)", of: (l) => l},
  };
  // A policy is the probability of going right in each room.
  const EXPERTS = {A: Array(ROOMS).fill(0.95), B: [0.95, 0.95, 0.95, 0.05, 0.05, 0.05, 0.05]};
  const rooms = [...Array(ROOMS).keys()];
  const left = (s) => Math.max(0, s - 1);

  // Solve x = b + γ M x, in which M[i] lists pairs (j, weight).
  function linear(b, m) {
    const rows = rooms.map((i) => {
      const row = rooms.map((j) => +(i === j));
      for (const [j, w] of m[i]) if (j < ROOMS) row[j] -= gamma * w;
      return [...row, b[i]];
    });
    for (const k of rooms) for (const i of rooms) {
      if (i === k) continue;
      const f = rows[i][k] / rows[k][k];
      for (let j = k; j <= ROOMS; j++) rows[i][j] -= f * rows[k][j];
    }
    return rooms.map((i) => rows[i][ROOMS] / rows[i][i]);
  }

  // The share of discounted time of [left, right] in each room.
  function occupancy(p) {
    const from = rooms.map(() => []);
    for (const s of rooms) {
      from[left(s)].push([s, 1 - p[s]]);
      if (s + 1 < ROOMS) from[s + 1].push([s, p[s]]);
    }
    const d = linear(rooms.map((s) => +(s === 3)), from), all = d.reduce((a, b) => a + b);
    return rooms.map((s) => [(d[s] * (1 - p[s])) / all, (d[s] * p[s]) / all]);
  }

  function actionValues(p, reward) {
    const v = linear(rooms.map((s) => (1 - p[s]) * reward[s][0] + p[s] * reward[s][1]),
      rooms.map((s) => [[left(s), 1 - p[s]], [s + 1, p[s]]]));
    return rooms.map((s) => [reward[s][0] + gamma * v[left(s)],
      reward[s][1] + gamma * (v[s + 1] || 0)]);
  }

  // One round: the best discriminator, the reward that it gives, and a step of the policy.
  function round(expert, p, reward) {
    const [theirs, mine] = [occupancy(expert), occupancy(p)];
    const r = rooms.map((s) => [0, 1].map((a) =>
      reward(Math.log((theirs[s][a] + 1e-6) / (mine[s][a] + 1e-6)))));
    const q = actionValues(p, r);
    const next = rooms.map((s) => {
      const [l, h] = [0, 1].map((a) => [1 - p[s], p[s]][a] * Math.exp(0.1 * q[s][a]));
      const [a, b] = [l, h].map((x) => Math.max(x / (l + h), 1e-6));
      return b / (a + b);
    });
    return {reward: r, policy: next};
  }

  // The share of episodes that have ended after so many steps.
  function gone(p, steps = 50) {
    let here = rooms.map((s) => +(s === 3));
    for (let t = 0; t < steps; t++) {
      const next = rooms.map(() => 0);
      for (const s of rooms) {
        next[left(s)] += here[s] * (1 - p[s]);
        if (s + 1 < ROOMS) next[s + 1] += here[s] * p[s];
      }
      here = next;
    }
    return 1 - here.reduce((a, b) => a + b);
  }

  function define(toy) {
    let expert = [...EXPERTS.A], kind = "survive", policy, reward, k, room = 3;
    let clock = 0, tick = 0;
    const crowd = (mine) => Array.from({length: count}, (_, i) => ({s: 3, before: 3, i, mine}));
    let crowds = [...crowd(false), ...crowd(true)];

    function restart() {
      policy = rooms.map(() => 0.5);
      k = 0;
      reward = round(expert, policy, REWARDS[kind].of).reward;
      tell();
    }

    function step() {
      ({reward, policy} = round(expert, policy, REWARDS[kind].of));
      k += 1;
      tell();
    }

    const percent = (x) => `${Math.round(100 * x)} %`;
    function tell() {
      const [theirs, mine] = [occupancy(expert), occupancy(policy)];
      let far = 0;
      for (const s of rooms) for (const a of [0, 1]) far += Math.abs(theirs[s][a] - mine[s][a]) / 2;
      toy.say(`Round ${k}. Gone after 50 steps: expert ${percent(gone(expert))}, imitator `
        + `${percent(gone(policy))}. Distance of their visits: ${percent(far)}.`, game.playing && k < rounds);
    }

    function walk() {
      tick += 1;
      const fresh = tick % 26 === 0;
      for (const one of crowds) {
        one.before = fresh ? 3 : one.s;
        if (fresh) one.s = 3;
        else if (one.s < ROOMS) {
          const p = (one.mine ? policy : expert)[one.s];
          one.s = Math.random() < p ? one.s + 1 : left(one.s);
        }
      }
    }

    const plan = (w, h) => {
      const x = 12, size = (w - x - 52) / ROOMS, tall = h * 0.27;
      return {x, size, tall, lanes: [h * 0.17, h * 0.56]};
    };

    const pane = toy.pane({
      label: "Seven rooms in a row and a door on the right; the expert above, its imitator below.",
      help: "Left and right arrow keys choose a room, up and down turn the expert in it.",
      ratio: 0.46,
      narrow: 0.95,
      draw: (ctx, w, h, colour) => {
        const g = plan(w, h);
        const most = 1.2 * Math.max(...[expert, policy].map((p) =>
          Math.max(...occupancy(p).map(([a, b]) => a + b))));
        [expert, policy].forEach((p, lane) => {
          const y = g.lanes[lane], paint = lane ? colour.learner : colour.expert;
          const share = occupancy(p);
          for (const s of rooms) {
            const x = g.x + s * g.size;
            ctx.fillStyle = colour.floor;
            ctx.fillRect(x + 1, y, g.size - 2, g.tall);
            if (lane) [0, 1].forEach((a) => {
              const r = Math.max(-1, Math.min(1, reward[s][a] / 2));
              ctx.fillStyle = window.toys.shade(r > 0 ? colour.reward : colour.penalty,
                0.75 * Math.abs(r));
              ctx.fillRect(x + 1 + (a * g.size) / 2, y, g.size / 2 - 1, g.tall);
            });
            const high = ((share[s][0] + share[s][1]) / most) * g.tall;
            ctx.globalAlpha = 0.45;
            ctx.fillStyle = paint;
            ctx.fillRect(x + g.size * 0.2, y + g.tall - high, g.size * 0.6, high);
            ctx.globalAlpha = 1;
            const turn = (2 * p[s] - 1) * 0.4 * g.size, middle = x + g.size / 2;
            const level = lane ? y + g.tall + 14 : y - 14;
            if (Math.abs(turn) > 3)
              window.toys.arrow(ctx, [middle - turn, level], [middle + turn, level], paint, 4, 8);
            else window.toys.dot(ctx, middle, level, 4, paint);
            if (!lane && s === room) window.toys.dot(ctx, middle, y - 14, 3, colour.card, colour.ink, 1.5);
          }
          const right = g.x + ROOMS * g.size;
          window.toys.line(ctx, [[right + 1, y], [g.x - 2, y], [g.x - 2, y + g.tall], [right + 1, y + g.tall]],
            colour.ink, 4);
          window.toys.line(ctx, [[right + 1, y], [right + 13, y - 12]], colour.wall, 5);
          window.toys.text(ctx, lane ? "imitator" : "expert", g.x, lane ? h - 12 : 13,
            {align: "left", size: 14, colour: colour.ink});
          window.toys.text(ctx, percent(gone(p)), right + 27, y + g.tall / 2 + (lane ? 0 : 2),
            {size: 14, colour: colour.ink, weight: 700});
          window.toys.text(ctx, "gone", right + 27, y + g.tall / 2 + 17, {size: 12, colour: colour.soft});
        });
        if (window.toys.calm()) return;
        const t = Math.min(1, clock / 0.3);
        for (const {s, before, i, mine} of crowds) {
          const at = before + t * (s - before);
          if (at > ROOMS - 0.1) continue;
          const x = g.x + (at + 0.2 + 0.6 * ((i * 0.755) % 1)) * g.size;
          const y = g.lanes[+mine] + g.tall * (0.16 + 0.7 * ((i * 0.57) % 1));
          window.toys.dot(ctx, x, y, 5, mine ? colour.learner : colour.expert, colour.rim, 1);
        }
      },
      grab: (x, y, ask) => {
        const g = plan(pane.w, pane.h), s = Math.floor((x - g.x) / g.size);
        const wanted = s >= 0 && s < ROOMS && y < g.lanes[0] + g.tall;
        if (wanted && !ask) { room = s; turn(x); }
        return wanted;
      },
      drag: turn,
      keys: {
        ArrowLeft: () => { room = left(room); },
        ArrowRight: () => { room = Math.min(ROOMS - 1, room + 1); },
        ArrowUp: () => set(expert[room] + 0.15),
        ArrowDown: () => set(expert[room] - 0.15),
      },
    });

    function turn(x) {
      const g = plan(pane.w, pane.h);
      set(0.5 + 1.4 * ((x - g.x) / g.size - room - 0.5));
    }

    function set(p) {
      expert[room] = Math.min(0.95, Math.max(0.05, Math.round(p * 20) / 20));
      restart();
    }

    const again = () => { restart(); game.playing = true; };
    toy.choice("The reward is", Object.fromEntries(Object.entries(REWARDS)
      .map(([key, {name}]) => [key, name])), kind, (key) => { kind = key; again(); });
    toy.choice("Expert", {A: "A leaves", B: "B stays"}, "A",
      (key) => { expert = [...EXPERTS[key]]; again(); });
    const game = toy.rounds({step, restart, over: () => k >= rounds});
    restart();
    toy.play((passed) => {
      if (window.toys.calm()) return undefined;
      clock += passed;
      if (clock > 0.45) {
        clock = 0;
        walk();
      }
      return true;
    });
    return {state: () => ({expert, kind, policy, reward, round: k}), pose: game.finish, finish: game.finish};
  }

  window.toys.corridor = {REWARDS, EXPERTS, occupancy, actionValues, round, gone};
  window.toys.definitions.corridor = define;
})();
