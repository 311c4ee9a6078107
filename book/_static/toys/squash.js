// The squashed Gaussian a = tanh(u), its density with and without the Jacobian.
(() => {
  const bins = 50, count = 20000;
  const normal = (u, mean, std) =>
    Math.exp(-(((u - mean) / std) ** 2) / 2) / (std * Math.sqrt(2 * Math.PI));
  const without = (a, mean, std) => normal(Math.atanh(a), mean, std);
  const density = (a, mean, std) => without(a, mean, std) / (1 - a * a);

  // The area under the second line: the mean of 1 - tanh² u.
  function area(mean, std) {
    let sum = 0;
    for (let k = -400; k <= 400; k++) {
      const u = mean + (std * k) / 50;
      sum += (normal(u, mean, std) * std * (1 - Math.tanh(u) ** 2)) / 50;
    }
    return sum;
  }

  function define(toy) {
    let mean = 0.5, std = 1, bars = [], samples = [];
    let seed = 1;
    const random = () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32 + 1e-12;
    for (let k = 0; k < count; k++)
      samples.push(Math.sqrt(-2 * Math.log(random())) * Math.cos(2 * Math.PI * random()));

    function set(m, s) {
      mean = Math.min(2, Math.max(-2, m));
      std = Math.min(2, Math.max(0.1, s));
      middle.set(mean);
      width.set(std);
      bars = Array(bins).fill(0);
      for (const z of samples) {
        const a = Math.tanh(mean + std * z);
        bars[Math.min(bins - 1, Math.floor(((a + 1) / 2) * bins))] += bins / 2 / count;
      }
      toy.say(`The area below the green line is 1. Without the Jacobian it is ${area(mean, std).toFixed(2)}: `
        + "no density.");
    }

    const box = (w, h) => ({x: 34, y: 16, w: w - 50, h: h - 56});
    const pane = toy.pane({
      label: "Samples of the squashed Gaussian as bars, and its density as lines.",
      help: "Left and right arrow keys move the mean, up and down the width.",
      shape: "toy-full",
      ratio: 0.45,
      narrow: 0.75,
      draw: (ctx, w, h, colour) => {
        const b = box(w, h), top = 2.4;
        const to = window.toys.axes(ctx, b, [-1, 1, 0, top], colour,
          {x: [-1, -0.5, 0, 0.5, 1], y: [0, 1, 2], xLabel: "action a"});
        ctx.save();
        ctx.beginPath();
        ctx.rect(b.x, b.y, b.w, b.h);
        ctx.clip();
        ctx.fillStyle = colour.visits[1];
        bars.forEach((v, k) => {
          const [x, y] = to(-1 + (2 * k) / bins, v);
          ctx.fillRect(x + 0.5, y, b.w / bins - 1, b.y + b.h - y);
        });
        for (const [line, ink, dash] of [[without, colour.wall, [7, 6]], [density, colour.good, []]]) {
          const points = [];
          for (let k = 1; k < 600; k++) {
            const a = -1 + k / 300;
            points.push(to(a, line(a, mean, std)));
          }
          window.toys.line(ctx, points, ink, 3.5, {dash});
        }
        ctx.restore();
        const [x, y] = to(Math.tanh(mean), 0);
        window.toys.line(ctx, [[x, y], [x, b.y + 40]], colour.soft, 1.5, {dash: [3, 4]});
        window.toys.dot(ctx, x, y - 10, 9, colour.learner, colour.rim, 2);
        window.toys.text(ctx, "with the Jacobian", b.x + 6, b.y + 8, {align: "left", colour: colour.good});
        window.toys.text(ctx, "without", b.x + 6, b.y + 26, {align: "left", colour: colour.wall});
      },
      grab: (x, y, ask) => {
        const b = box(pane.w, pane.h), inside = x > b.x && x < b.x + b.w && y > b.y + 0.6 * b.h;
        if (inside && !ask) aim(x);
        return inside;
      },
      drag: (x) => aim(x),
      keys: window.toys.arrowKeys((dx, dy) => set(mean + 0.1 * dx, std + 0.1 * dy)),
    });

    function aim(x) {
      const b = box(pane.w, pane.h), a = (2 * (x - b.x)) / b.w - 1;
      set(Math.atanh(Math.min(0.97, Math.max(-0.97, a))), std);
    }

    const show = (x) => x.toFixed(2).replace("-", "−");
    const middle = toy.slider("mean μ of u", {min: -2, max: 2, step: 0.05, value: mean, show},
      (x) => set(x, std));
    const width = toy.slider("width σ of u", {min: 0.1, max: 2, step: 0.05, value: std, show},
      (x) => set(mean, x));
    set(mean, std);
    return {state: () => ({mean, std, bars}), pose: () => set(0.5, 1.2)};
  }

  window.toys.squash = {density, without, area};
  window.toys.definitions.squash = define;
})();
