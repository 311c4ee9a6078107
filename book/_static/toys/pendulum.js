// Gymnasium's pendulum, chapter 4's actor and critics, and a hand that may take the motor.
(() => {
  const DT = 0.05, STRONG = 2, FAST = 8, EDGE = 225, EPISODE = 200;
  const limit = (x, most) => Math.min(most, Math.max(-most, x));
  const turn = 2 * Math.PI, fromTop = (angle) => angle - turn * Math.floor((angle + Math.PI) / turn);

  // A step of the state [angle from the top, speed] with a torque.
  function step([angle, speed], torque) {
    const u = limit(torque, STRONG);
    const next = limit(speed + (15 * Math.sin(angle) + 3 * u) * DT, FAST);
    const reward = -(fromTop(angle) ** 2 + 0.1 * speed ** 2 + 0.001 * u ** 2);
    return {state: [angle + next * DT, next], reward};
  }

  // The layers of a network as [inputs, weights and then biases].
  function decode(layers, inputs) {
    return layers.map(({scale, numbers}) => {
      const bytes = Uint8Array.from(atob(numbers), (c) => c.charCodeAt(0));
      const values = Float64Array.from(new Int16Array(bytes.buffer), (x) => scale * x);
      const layer = {inputs, values, outputs: values.length / (inputs + 1)};
      inputs = layer.outputs;
      return layer;
    });
  }

  // ReLU after each layer but the last.
  function forward(net, x) {
    net.forEach(({inputs, outputs, values}, k) => {
      const next = new Float64Array(outputs), linear = k === net.length - 1;
      for (let i = 0; i < outputs; i++) {
        let sum = values[inputs * outputs + i];
        for (let j = 0; j < inputs; j++) sum += values[i * inputs + j] * x[j];
        next[i] = linear ? sum : Math.max(0, sum);
      }
      x = next;
    });
    return x;
  }

  const actor = decode(window.toys.networks.actor, 3);
  const critics = window.toys.networks.critics.map((layers) => decode(layers, 4));
  const observe = ([angle, speed]) => [Math.cos(angle), Math.sin(angle), speed / FAST];

  // The action without noise, as a torque, and the smaller of its values.
  const act = (state) => STRONG * Math.tanh(forward(actor, observe(state))[0]);
  const worth = (state) => Math.min(...critics.map((net) =>
    forward(net, [...observe(state), act(state) / STRONG])[0]));

  function define(toy) {
    const wide = 90, high = 48, raster = window.toys.raster(wide, high), values = [];
    for (let i = 0; i < wide * high; i++) {
      const x = (((i % wide) + 0.5) / wide * 2 - 1) * EDGE;
      const y = (1 - ((Math.floor(i / wide) + 0.5) / high) * 2) * FAST;
      values.push(worth([Math.PI + (x * Math.PI) / 180, y]));
    }
    const [least, most] = [Math.min(...values), Math.max(...values)];
    let state, before, start, trail, time, total, since, torque = 0;
    let steers = "actor", pull = null, push = 0, left = 0, placing = false, clock = 0;

    const shown = ([angle, speed]) => [(fromTop(angle - Math.PI) * 180) / Math.PI, speed];
    const bob = ([angle]) => [-Math.sin(angle), -Math.cos(angle)];
    const hand = () => pull !== null || left > 0;

    function tell(quiet) {
      const who = hand() ? "You steer" : steers === "actor" ? "The actor steers" : "The motor is off";
      const up = since === null ? "" : ` Upright since ${(since * DT).toFixed(1)} s.`;
      const sum = `${Math.round(total)}`.replace("-", "−");
      toy.say(`${who}. Return ${sum} after ${Math.min(time, EPISODE)} steps.${up}`, quiet);
    }

    function advance() {
      const mine = hand();
      if (pull) {
        const [x, y] = bob(state);
        torque = STRONG * limit(3 * (pull[0] * y - pull[1] * x), 1);
      } else if (left > 0) torque = -push * STRONG * Math.sign(Math.cos(state[0]) || 1);
      else torque = steers === "actor" ? act(state) : 0;
      left = Math.max(0, left - 1);
      const next = step(state, torque);
      if (time < EPISODE) total += next.reward;
      [before, state] = [state, next.state];
      time += 1;
      const up = Math.cos(state[0]) > 0.95 && Math.abs(state[1]) < 1;
      since = up ? since ?? time : null;
      // On the map the angle goes on past the top, as long as there is room.
      const [x, y] = shown(state), last = trail[trail.length - 1];
      const near = [x - 360, x, x + 360].filter((v) => Math.abs(v) <= EDGE)
        .sort((a, b) => Math.abs(a - last.x) - Math.abs(b - last.x))[0];
      trail.push({x: near, y, mine, jump: Math.abs(near - last.x) > 180});
      if (trail.length > 2 * EPISODE) trail.shift();
      tell(time !== EPISODE);
    }

    // Whoever prefers no motion sees where it ends.
    function run(steps = EPISODE) {
      if (window.toys.calm() && !pull) for (let k = 0; k < steps; k++) advance();
      toy.redraw();
    }

    function place(x, y) {
      start = [limit(x, EDGE), limit(y, FAST)];
      state = before = [Math.PI + (start[0] * Math.PI) / 180, start[1]];
      trail = [{x: start[0], y: start[1]}];
      [time, total, since, torque, left] = [0, 0, null, 0, 0];
      tell();
    }

    function shove(sign) {
      [push, left] = [sign, 5];
      run(steers === "actor" ? EPISODE / 2 : 5);
    }

    const round = (w, h) => ({x: w / 2, y: h / 2, r: 0.4 * Math.min(w, h)});
    const reach = (x, y) => {
      const c = round(swing.w, swing.h);
      return [(x - c.x) / c.r, (y - c.y) / c.r];
    };
    const swing = toy.pane({
      title: "the pendulum",
      label: "A pendulum on a motor that is too weak to lift it.",
      help: "Left and right arrow keys push it for a quarter of a second, space hands the motor over.",
      narrow: 0.62,
      draw: (ctx, w, h, colour) => {
        const {x, y, r} = round(w, h), part = window.toys.calm() ? 1 : clock / DT;
        const [u, v] = bob([before[0] + part * (state[0] - before[0])]);
        window.toys.dot(ctx, x, y, 1.18 * r, colour.floor);
        const tail = trail.slice(-16).map((p) => [x + r * Math.sin((p.x * Math.PI) / 180),
          y + r * Math.cos((p.x * Math.PI) / 180)]);
        window.toys.line(ctx, tail, colour.learner, 6, {alpha: 0.45});
        if (pull) window.toys.line(ctx, [[x + r * u, y + r * v], [x + r * pull[0], y + r * pull[1]]],
          colour.copy, 3, {dash: [4, 6]});
        window.toys.line(ctx, [[x, y], [x + r * u, y + r * v]], colour.ink, 9);
        window.toys.dot(ctx, x + r * u, y + r * v, 15, colour.learner, colour.rim, 2.5);
        // The torque, as an arc round the motor.
        const ink = hand() ? colour.copy : colour.policy, size = torque / STRONG;
        if (Math.abs(size) > 0.12) {
          const end = -Math.PI / 2 - 2 * size;
          ctx.beginPath();
          ctx.arc(x, y, 0.34 * r, -Math.PI / 2, end, size > 0);
          ctx.strokeStyle = ink;
          ctx.lineWidth = 5;
          ctx.stroke();
          const at = (angle) => [x + 0.34 * r * Math.cos(angle), y + 0.34 * r * Math.sin(angle)];
          window.toys.arrow(ctx, at(end), at(end - 0.25 * Math.sign(size)), ink, 5, 9);
        }
        window.toys.dot(ctx, x, y, 8, colour.ink, colour.card, 2);
      },
      grab: (x, y, ask) => {
        const [u, v] = reach(x, y), inside = Math.hypot(u, v) < 1.2;
        if (inside && !ask) pull = [u, v];
        return inside;
      },
      drag: (x, y) => { pull = reach(x, y); },
      drop: () => { pull = null; run(); },
      keys: {
        ArrowLeft: () => shove(-1),
        ArrowRight: () => shove(1),
        Space: () => handOver(steers === "actor" ? "nobody" : "actor"),
      },
    });

    const box = (w, h) => ({x: 26, y: 24, w: w - 36, h: h - 46});
    const map = toy.pane({
      title: "all its states, by what they are worth",
      label: "A map of angle and speed, coloured by the critics' value, with the way of the pendulum.",
      help: "Arrow keys move the state it starts from.",
      scale: ["worth least", "most"],
      shape: "toy-wide",
      ratio: 0.49,
      narrow: 0.7,
      draw: (ctx, w, h, colour) => {
        const b = box(w, h);
        raster.colours((i) => window.toys.shade(colour.reward, (values[i] - least) / (most - least)), colour);
        raster.draw(ctx, b);
        const to = window.toys.axes(ctx, b, [-EDGE, EDGE, -FAST, FAST],
          {...colour, line: "transparent", soft: colour.frame},
          {y: [-8, -4, 0, 4, 8], yLabel: "speed (rad/s)"});
        for (const [x, name] of [[-180, "upright"], [0, "hanging"], [180, "upright"]])
          window.toys.text(ctx, name, to(x, 0)[0], b.y + b.h + 11,
            {size: 12, colour: colour.frame, weight: 500});
        for (const sign of [-1, 1]) { // Just enough energy to come to rest at the top.
          const line = Array.from({length: 91}, (_, i) => {
            const x = (i / 45 - 1) * EDGE;
            return to(x, sign * Math.sqrt(30 * (1 + Math.cos((x * Math.PI) / 180))));
          });
          window.toys.line(ctx, line, colour.ink, 1.5, {dash: [3, 6]});
        }
        for (const rim of [true, false]) trail.forEach((p, i) => {
          if (i && !p.jump) window.toys.line(ctx, [to(trail[i - 1].x, trail[i - 1].y), to(p.x, p.y)],
            rim ? colour.card : p.mine ? colour.copy : colour.policy, rim ? 6.5 : 3.5);
        });
        const last = trail[trail.length - 1];
        window.toys.dot(ctx, ...to(...start), 5, colour.card, colour.ink, 2.5);
        window.toys.dot(ctx, ...to(last.x, last.y), 9, colour.learner, colour.rim, 2.5);
      },
      grab: (x, y, ask) => {
        const b = box(map.w, map.h), inside = x > b.x && x < b.x + b.w && y > b.y && y < b.y + b.h;
        if (inside && !ask) { placing = true; aim(x, y); }
        return inside;
      },
      drag: aim,
      drop: () => { placing = false; run(); },
      keys: window.toys.arrowKeys((dx, dy) => { place(start[0] + 10 * dx, start[1] + 0.5 * dy); run(); }),
    });

    function aim(x, y) {
      const b = box(map.w, map.h);
      place((((x - b.x) / b.w) * 2 - 1) * EDGE, (1 - ((y - b.y) / b.h) * 2) * FAST);
    }

    const motor = toy.choice("The motor is", {actor: "the actor's", nobody: "off"}, steers,
      handOver);
    function handOver(key) {
      steers = key;
      motor.set(key);
      run();
      tell();
    }
    toy.button("Hang it down", () => { place(0, 0); run(); });
    place(0, 0);
    run();
    toy.play((passed) => {
      if (placing || (window.toys.calm() && !pull)) return undefined;
      for (clock += passed; clock >= DT; clock -= DT) advance();
      return true;
    });
    return {state: () => ({state, time, total, since, steers, start, trail}),
      pose: () => { place(0, 0); run(); }};
  }

  window.toys.pendulum = {step, act, worth};
  window.toys.definitions.pendulum = define;
})();
