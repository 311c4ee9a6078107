// Drag the wall: an agent that copies moves, and one that plans with a learned reward.
(() => {
  const {MOVES, A, build, book, solve, visits, walk, likeliest, board, ...paint} = window.toys.mazes;
  const n = 20, S = n * n, gamma = 0.97, steps = 100, rate = 0.05;
  const LEFT = book(n, "Left");

  // Three demonstrations by the expert of chapter 1: soft-optimal, so that it sometimes errs.
  function given() {
    const to = build(n, LEFT.wall), {policy} = solve(to, LEFT.reward, 0.05, gamma);
    let seed = 2;
    const random = () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32;
    return [1, 2, 3].map(() => {
      const states = [LEFT.start], actions = [];
      for (let s = LEFT.start; s !== LEFT.goal && actions.length < 200;) {
        let a = 0;
        for (let u = random() - policy[s * A]; u > 0 && a < A - 1;) u -= policy[s * A + ++a];
        actions.push(a);
        states.push((s = to[s * A + a]));
      }
      return {states, actions};
    });
  }

  // Discounted visits of demonstrations that stay at their last square for ever, and their starts.
  function count(demos) {
    const seen = new Float64Array(S), initial = new Float64Array(S);
    for (const {states} of demos) {
      initial[states[0]] += 1 / demos.length;
      states.forEach((s, t) => {
        seen[s] += (gamma ** t / demos.length) * (t === states.length - 1 ? 1 / (1 - gamma) : 1);
      });
    }
    return {seen, initial};
  }

  // A sum of soft bumps, one on each square, so that neighbours learn together.
  const BUMP = Array.from({length: n}, (_, i) =>
    Float64Array.from({length: n}, (_, j) => Math.exp(-((i - j) ** 2) / 2)));
  function spread(values) {
    const half = new Float64Array(S), whole = new Float64Array(S);
    for (let r = 0; r < n; r++) for (let c = 0; c < n; c++)
      for (let k = 0; k < n; k++) half[r * n + c] += BUMP[c][k] * values[r * n + k];
    for (let r = 0; r < n; r++) for (let c = 0; c < n; c++)
      for (let k = 0; k < n; k++) whole[r * n + c] += BUMP[r][k] * half[k * n + c];
    return whole;
  }

  // Maximum entropy IRL by gradient ascent: the expert's visits minus the policy's. Each step
  // yields the reward, with a temperature of 1, and that difference.
  function* learning(to, demos) {
    const {seen, initial} = count(demos), reward = new Float64Array(S);
    let value;
    for (;;) {
      const found = solve(to, reward, 1, gamma, {guess: value});
      value = found.value;
      const visited = visits(to, found.policy, initial, gamma);
      const difference = seen.map((x, s) => x - visited[s]);
      yield {reward: reward.slice(), difference};
      spread(difference).forEach((x, s) => { reward[s] += rate * x; });
    }
  }

  // The copy: in each square the move of the demonstration that is next to its end there, and
  // where none has been the move of the nearest such square.
  function copy(demos) {
    const left = new Map();
    for (const {states, actions} of demos)
      states.forEach((s, t) => {
        const rest = actions.length - t;
        if (!left.has(s) || rest < left.get(s).rest) left.set(s, {rest, action: actions[t] || 0});
      });
    return Array.from({length: S}, (_, s) => {
      let best = {far: Infinity}, known = left.get(s);
      if (known) return known.action;
      for (const [u, {rest, action}] of left) {
        const far = ((s % n) - (u % n)) ** 2 + (Math.floor(s / n) - Math.floor(u / n)) ** 2;
        if (far < best.far || (far === best.far && rest < best.rest)) best = {far, rest, action};
      }
      return best.action || 0;
    });
  }

  const plan = (to, reward) => likeliest(solve(to, reward, 0, gamma).policy);

  function arrives(way, demos) {
    const s = way[way.length - 1];
    return demos.some(({states}) => {
      const end = states[states.length - 1];
      return Math.abs((s % n) - (end % n)) <= 1
        && Math.abs(Math.floor(s / n) - Math.floor(end / n)) <= 1;
    });
  }

  function define(toy) {
    let demos = given(), home = {...LEFT.wall}, start = LEFT.start;
    let history = [], shown = 0, lesson = null, ways = {}, clock = 0, drawing = false;
    let stroke = null, pen = start, hint = true;
    const hand = paint.movable(n, home, wallMoved);
    const moved = () => hand.wall.row !== home.row || hand.wall.from !== home.from;

    function think() {
      const to = build(n, hand.wall), imitate = copy(demos), best = plan(to, history[shown].reward);
      ways = {copy: walk(to, (s) => imitate[s], start), learner: walk(to, best, start)};
      clock = window.toys.calm() ? 1e6 : 0;
      tell();
    }

    function tell() {
      const fate = (way, lost) => (arrives(way, demos) ? "arrives" : lost);
      const [c, l] = [fate(ways.copy, "stuck"), fate(ways.learner, "does not know the way yet")];
      const where = shown < steps ? `After ${shown} steps of learning. ` : "";
      const next = moved() || shown < steps ? "" : " Now drag the wall.";
      toy.say(`${where}Copy: ${c}. Reward: ${l}.${next}`, Boolean(lesson));
    }

    function learn() {
      history = [];
      lesson = learning(build(n, home), demos);
      history.push(lesson.next().value);
      shown = 0;
      think();
    }

    function finish() {
      while (history.length <= steps) history.push(lesson.next().value);
      shown = steps;
      slider.set(shown);
      lesson = null;
    }

    function wallMoved() {
      hint = false;
      if (!history.length) return;
      if (lesson) finish();
      think();
    }

    // A stroke goes where an agent could go.
    function extend(target) {
      const to = build(n, home);
      for (let s = stroke.states[stroke.states.length - 1]; s !== target;) {
        const dx = (target % n) - (s % n), dy = Math.floor(target / n) - Math.floor(s / n);
        const tries = [dx ? (dx > 0 ? 1 : 3) : 0, dy ? (dy > 0 ? 2 : 4) : 0];
        if (Math.abs(dy) > Math.abs(dx)) tries.reverse();
        const a = tries.find((i) => i && to[s * A + i] !== s);
        if (!a) break;
        s = to[s * A + a];
        stroke.actions.push(a);
        stroke.states.push(s);
      }
      pen = stroke.states[stroke.states.length - 1];
    }

    function begin(s) {
      if (!demos.length) home = {...hand.wall};
      hand.wall = {...home};
      stroke = {states: [s], actions: []};
      pen = s;
      toy.say("Draw to the place where the expert wants to be, and let go.");
    }

    function end() {
      const made = stroke;
      stroke = null;
      if (made.actions.length < 3) return toy.say("That was short. Draw a longer way.");
      demos.push(made);
      start = demos[0].states[0];
      learn();
    }

    function draw() {
      drawing = true;
      hand.wall = {...home}; // where a reader has left it, nothing would be blocked later
      [demos, ways, history, lesson] = [[], {}, [], null];
      pen = LEFT.start;
      toy.say("Draw a way from anywhere to the place you like. (Keys: space, arrows, space.)");
    }

    function examples() {
      drawing = false;
      [demos, home, start] = [given(), {...LEFT.wall}, LEFT.start];
      hand.wall = {...home};
      learn();
    }

    function download() {
      const content = {cells: n, wall: home, demonstrations: demos};
      const file = new Blob([JSON.stringify(content)], {type: "application/json"});
      const link = window.toys.element("a",
        {href: URL.createObjectURL(file), download: "demonstrations.json"});
      link.click();
      URL.revokeObjectURL(link.href);
    }

    function scene(ctx, w, h, colour) {
      const b = board(n, w), now = history[shown];
      const top = now ? Math.max(5, ...now.reward) : 1;
      paint.squares(ctx, b, (s) =>
        window.toys.shade(colour.reward, now ? Math.max(0, now.reward[s] / top) ** 0.45 : 0), colour);
      for (const {states} of stroke ? [...demos, stroke] : demos)
        window.toys.line(ctx, states.map(b.centre), colour.expert, 3, {alpha: 0.65});
      if (moved()) paint.wall(ctx, b, home, colour, {ghost: true});
      const width = Math.max(3, b.size / 4);
      if (ways.learner) window.toys.line(ctx, ways.learner.map(b.centre), colour.learner, width + 2);
      if (ways.copy)
        window.toys.line(ctx, ways.copy.map(b.centre), colour.copy, width, {dash: [1, width * 2]});
      const ends = demos.length ? demos.map(({states}) => states[states.length - 1]) : [];
      for (const s of new Set(ends))
        window.toys.star(ctx, ...b.centre(s), Math.max(9, b.size * 0.95), colour.star, colour.rim);
      const pulse = hint && !lesson && !drawing && !window.toys.calm();
      hand.draw(ctx, b, colour, pulse ? 5 * Math.abs(Math.sin(clock * 2.5)) : 0);
      if (drawing && !ways.copy)
        window.toys.dot(ctx, ...b.centre(pen), b.size * 0.45, colour.expert, colour.card);
      if (ways.copy && !stroke) {
        figure(ctx, b, ways.learner, colour.learner, colour, 0.12);
        figure(ctx, b, ways.copy, colour.copy, colour, -0.12);
      }
    }

    // Somebody on the way, who bumps for ever into what stops it.
    function figure(ctx, b, way, fill, colour, aside) {
      const last = way.length - 1, t = Math.min(last, clock * 8), i = Math.min(last - 1, Math.floor(t));
      const [from, to] = [b.centre(way[Math.max(0, i)]), b.centre(way[last ? i + 1 : 0])];
      let x = from[0] + (t - i) * (to[0] - from[0]), y = from[1] + (t - i) * (to[1] - from[1]);
      let look = [Math.sign(to[0] - from[0]), Math.sign(from[1] - to[1])];
      const over = window.toys.calm() ? 0 : clock - last / 8;
      const glad = arrives(way, demos);
      if (glad && over > 0) y -= 0.35 * b.size * Math.abs(Math.sin(over * 6));
      if (!glad && t >= last - 1 && way === ways.copy) {
        const [dx, dy] = MOVES[copy(demos)[way[last]]];
        const push = over > 0 || last === 1 ? 0.3 * b.size * Math.abs(Math.sin(clock * 7)) : 0;
        look = [dx, dy];
        x += push * dx;
        y -= push * dy;
        const cry = look[1] >= 0 ? 1 : -1;
        window.toys.text(ctx, "?", x + 0.9 * b.size, y + cry * 0.5 * b.size,
          {size: 15, weight: 800, colour: fill, halo: colour.card});
      }
      paint.walker(ctx, x + aside * b.size, y, Math.max(7, 0.52 * b.size), fill, colour, look);
    }

    const step = (dx, dy) => {
      if (!drawing) return hand.move({from: hand.wall.from + dx, row: hand.wall.row + dy});
      const to = Math.min(n - 1, Math.max(0, (pen % n) + dx))
        + n * Math.min(n - 1, Math.max(0, Math.floor(pen / n) + dy));
      if (stroke) extend(to);
      else pen = to;
      if (!stroke) ways = {};
    };
    const space = () => {
      if (!drawing) return (clock = 0);
      return stroke ? end() : begin(pen);
    };

    const pane = toy.pane({
      label: "A maze with a wall that you can move.",
      help: "Arrow keys move the wall. Space lets both agents walk again.",
      shape: "toy-wide",
      scale: ["low learned reward", "high"],
      draw: scene,
      keys: {...window.toys.arrowKeys(step), Space: space, Enter: space},
      grab: (x, y, ask) => {
        const b = board(n, pane.w), wanted = hand.hit(b, x, y);
        if (!ask && wanted) hand.grab(b, x, y);
        else if (!ask && drawing) begin(b.at(x, y));
        return wanted || drawing;
      },
      drag: (x, y) => {
        const b = board(n, pane.w);
        if (hand.holds()) hand.drag(b, x, y);
        else extend(b.at(x, y));
      },
      drop: () => {
        if (stroke) end();
        hand.drop();
      },
    });

    toy.pane({
      label: "What the last step of learning changes.",
      caption: "<b>What learning compares.</b> <i class='toy-expert'>Violet</i>: the expert is "
        + "here more often than the learner, so the reward rises. <i class='toy-policy'>Orange</i>: "
        + "the learner is, so it falls.",
      draw: (ctx, w, h, colour) => {
        const b = board(n, w), now = history[shown];
        paint.squares(ctx, b, (s) => {
          const x = now ? now.difference[s] : 0;
          return window.toys.shade(colour.difference,
            0.5 + 0.5 * Math.sign(x) * Math.min(1, Math.abs(x) / 1.5) ** 0.5);
        }, colour);
        paint.wall(ctx, b, home, colour);
      },
    });

    const slider = toy.slider("steps of learning", {min: 0, max: steps, value: 0}, (k) => {
      if (!history.length) return;
      if (lesson) finish();
      shown = k;
      slider.set(k);
      think();
    });
    toy.button("Learn again", () => demos.length && learn());
    toy.button("Draw your own", draw, {strong: true});
    toy.button("Three examples", examples);
    toy.button("Download", download, {label: "Download these demonstrations"});

    learn();
    toy.play((passed) => {
      if (lesson && !hand.holds()) {
        if (window.toys.calm()) {
          finish();
          think();
          return true;
        }
        for (const until = performance.now() + 9; performance.now() < until;) {
          history.push(lesson.next().value);
          if (history.length % 2) break;
        }
        shown = history.length - 1;
        slider.set(shown);
        if (shown >= steps) lesson = null;
        if (shown % 5 === 0) think();
        else tell();
        return true;
      }
      if (window.toys.calm()) return undefined;
      clock += passed;
      const rest = Math.max(...Object.values(ways).map((way) => way.length), 0) / 8 + 2.5;
      if (clock > rest) clock = 0;
      return true;
    });
    return {
      state: () => ({demos, home, wall: hand.wall, shown, ways, learning: Boolean(lesson)}),
      pose: () => hand.move({from: 9}),
    };
  }

  window.toys.walls = {n, gamma, given, count, spread, learning, copy, plan, arrives};
  window.toys.definitions.walls = define;
})();
