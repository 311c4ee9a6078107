// A reward that networks have learned in the maze with physics: move the wall, and plan on it.
(() => {
  const {build, book, solve, walk, likeliest, board, ...paint} = window.toys.mazes;
  const {cells: n, rewards} = window.toys.tables;
  const gamma = 0.97, LEFT = book(n, "Left"), RIGHT = book(n, "Right");

  const planned = (wall, reward, guess) =>
    solve(build(n, wall), reward.map((x) => x / 999), 0, gamma, {guess});

  // How far a square is from the star, in centimetres.
  const far = (s) => 70 / n * Math.hypot((s % n) - (LEFT.goal % n),
    Math.floor(s / n) - Math.floor(LEFT.goal / n));

  function define(toy) {
    let seed = 0, start = LEFT.start, ways, policy, value, clock = 0;
    const before = {}; // for each seed the policy in the maze of the demonstrations
    const hand = paint.movable(n, LEFT.wall, think);

    function think() {
      ({policy, value} = planned(hand.wall, rewards[seed], value));
      ways = walk(build(n, hand.wall), likeliest(policy), start);
      clock = window.toys.calm() ? 1e6 : 0;
      const left = far(ways[ways.length - 1]);
      before[seed] ??= planned(LEFT.wall, rewards[seed]).policy;
      const there = hand.wall.row !== LEFT.wall.row || hand.wall.from !== LEFT.wall.from;
      const old = walk(build(n, LEFT.wall), likeliest(before[seed]), start);
      toy.say(`Reward of seed ${seed}: ${left < 5 ? "arrives" : "stops"} ${left.toFixed(0)} cm from the `
        + `star, after ${ways.length - 2} moves of ${(70 / n).toFixed(1)} cm`
        + (there ? ` (${old.length - 2} before the wall moved).` : "."));
    }

    function begin(column, row) {
      const [c, r] = [column, row].map((i) => Math.min(n - 1, Math.max(0, i)));
      start = c + n * r;
      think();
    }

    const pane = toy.pane({
      label: "The maze, coloured by a learned reward, with the way that is planned on it.",
      help: "Arrow keys move the wall, with the shift key the start. Space lets the agent walk again.",
      shape: "toy-alone",
      scale: ["low reward", "high"],
      draw: (ctx, w, h, colour) => {
        const b = board(n, w);
        paint.squares(ctx, b, (s) => window.toys.shade(colour.reward, rewards[seed][s] / 999), colour);
        paint.arrows(ctx, b, policy, colour.ink);
        paint.wall(ctx, b, LEFT.wall, colour, {ghost: true});
        window.toys.line(ctx, ways.map(b.centre), colour.card, 8);
        window.toys.line(ctx, ways.map(b.centre), colour.learner, 5);
        window.toys.star(ctx, ...b.centre(LEFT.goal), Math.max(9, 1.2 * b.size), colour.star, colour.rim);
        hand.draw(ctx, b, colour);
        const last = ways.length - 1, t = Math.min(last, clock * 10), i = Math.min(last - 1, Math.floor(t));
        const [from, to] = [b.centre(ways[i]), b.centre(ways[i + 1])];
        const at = [0, 1].map((k) => from[k] + (t - i) * (to[k] - from[k]));
        paint.walker(ctx, ...at, Math.max(8, 0.7 * b.size), colour.learner, colour,
          [Math.sign(to[0] - from[0]), Math.sign(from[1] - to[1])]);
        window.toys.dot(ctx, ...b.centre(start), Math.max(5, 0.4 * b.size), colour.card, colour.ink, 3);
      },
      grab: (x, y, ask) => {
        const b = board(n, pane.w), [u, v] = b.centre(start);
        const near = Math.hypot(x - u, y - v) < 22, wanted = hand.hit(b, x, y);
        if (ask) return near || wanted;
        if (wanted) hand.grab(b, x, y);
        return near || wanted;
      },
      drag: (x, y) => {
        const b = board(n, pane.w);
        if (hand.holds()) return hand.drag(b, x, y);
        const s = b.at(x, y);
        begin(s % n, Math.floor(s / n));
      },
      drop: hand.drop,
      keys: {
        ...window.toys.arrowKeys((dx, dy, {shiftKey}) => (shiftKey ? begin((start % n) + dx, Math.floor(start / n) + dy)
          : hand.move({from: hand.wall.from + dx, row: hand.wall.row + dy}))),
        Space: () => { clock = 0; },
      },
    });

    toy.choice("Reward of seed", Object.fromEntries(rewards.map((_, k) => [k, `${k}`])), "0",
      (key) => { seed = +key; think(); });
    toy.button("Move the wall", () => {
      const there = hand.wall.from === LEFT.wall.from ? RIGHT.wall.from : LEFT.wall.from;
      hand.move({from: there, row: LEFT.wall.row});
    }, {strong: true});
    think();
    toy.play((passed) => {
      if (window.toys.calm()) return undefined;
      clock += passed;
      if (clock > ways.length / 10 + 2) clock = 0;
      return true;
    });
    return {state: () => ({seed, start, wall: hand.wall, way: ways}),
      pose: () => hand.move({from: RIGHT.wall.from})};
  }

  window.toys.drawn_maze = {planned, far};
  window.toys.definitions.drawn_maze = define;
})();
