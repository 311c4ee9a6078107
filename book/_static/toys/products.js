// Two Gaussian policies over two actions, multiplied and added, with a gate's weights.
(() => {
  const reach = 2.6;

  // Mean and standard deviation of the product, for each component: precisions add up.
  function compose(primitives, weights) {
    return [0, 1].map((i) => {
      const precision = primitives.map(({std}, k) => weights[k] / std[i] ** 2);
      const total = precision.reduce((a, b) => a + b);
      return {
        mean: primitives.reduce((sum, {mean}, k) => sum + precision[k] * mean[i], 0) / total,
        std: 1 / Math.sqrt(total),
      };
    });
  }

  const density = ({mean, std}, [x, y]) => Math.exp(-(((x - mean[0]) / std[0]) ** 2
    + ((y - mean[1]) / std[1]) ** 2) / 2) / (2 * Math.PI * std[0] * std[1]);

  // Both as functions of the two actions.
  function product(primitives, weights) {
    const parts = compose(primitives, weights);
    const one = {mean: parts.map((p) => p.mean), std: parts.map((p) => p.std)};
    return (x) => density(one, x);
  }

  function mixture([one, other], weights) {
    const share = weights[0] / (weights[0] + weights[1]);
    return (x) => share * density(one, x) + (1 - share) * density(other, x);
  }

  function define(toy) {
    const primitives = [{mean: [0.9, 0.3], std: [0.2, 0.9]}, {mean: [-0.7, -0.9], std: [0.9, 0.2]}];
    const weights = [0.5, 0.5], grid = 72;
    let chosen = 0, held = null;

    const handles = () => primitives.flatMap(({mean: [x, y], std: [u, v]}, k) => [
      {k, part: "mean", at: [x, y]}, {k, part: 0, at: [x + 2 * u, y]}, {k, part: 1, at: [x, y + 2 * v]}]);

    function tell() {
      const [x, y] = compose(primitives, weights);
      const number = (v) => v.toFixed(1).replace("-0.0", "0.0").replace("-", "−");
      toy.say(`The product: mean (${number(x.mean)}, ${number(y.mean)}), `
        + `widths ${number(x.std)} and ${number(y.std)}. It does both at once; the sum does either.`);
    }

    function move({k, part}, [x, y]) {
      const limit = (v, low, high) => Math.min(high, Math.max(low, v));
      const {mean, std} = primitives[k];
      if (part === "mean") {
        mean[0] = limit(x, -2.2, 2.2);
        mean[1] = limit(y, -2.2, 2.2);
      } else std[part] = limit(([x, y][part] - mean[part]) / 2, 0.12, 1.2);
      tell();
    }

    const to = (w) => (x, y) => [w / 2 + (x / reach) * (w / 2), w / 2 - (y / reach) * (w / 2)];
    const from = (w, x, y) => [(x / w * 2 - 1) * reach, (1 - y / w * 2) * reach];

    function nudge(dx, dy) {
      const one = handles()[chosen];
      move(one, [one.at[0] + dx, one.at[1] + dy]);
    }

    [["multiplied", product], ["added", mixture]].forEach(([title, together]) => {
      const raster = window.toys.raster(grid, grid);
      const pane = toy.pane({
        title,
        label: `Two policies over two actions, ${title}.`,
        help: "Space chooses a handle, arrow keys move it.",
        draw: (ctx, w, h, colour) => {
          const value = together(primitives, weights);
          const values = Float64Array.from({length: grid ** 2},
            (_, i) => value(from(grid, (i % grid) + 0.5, Math.floor(i / grid) + 0.5)));
          const most = Math.max(...values);
          raster.colours((i) => window.toys.shade(colour.reward, (values[i] / most) ** 0.8));
          raster.draw(ctx, {x: 0, y: 0, w, h});
          const place = to(w);
          window.toys.line(ctx, [place(-reach, 0), place(reach, 0)], colour.line, 1);
          window.toys.line(ctx, [place(0, -reach), place(0, reach)], colour.line, 1);
          primitives.forEach(({mean, std}, k) => {
            ctx.beginPath();
            ctx.ellipse(...place(...mean), std[0] / reach * w, std[1] / reach * w, 0, 0, 2 * Math.PI);
            ctx.strokeStyle = k ? colour.copy : colour.expert;
            ctx.lineWidth = 3;
            ctx.stroke();
          });
          handles().forEach(({k, part, at}, i) => {
            const paint = k ? colour.copy : colour.expert, [x, y] = place(...at);
            if (document.activeElement === pane.canvas && i === chosen)
              window.toys.dot(ctx, x, y, 13, `${paint}55`);
            if (part === "mean") window.toys.dot(ctx, x, y, 9, paint, colour.card, 2);
            else window.toys.dot(ctx, x, y, 6, colour.card, paint, 3);
          });
          if (together === product) {
            const [x, y] = compose(primitives, weights);
            window.toys.star(ctx, ...place(x.mean, y.mean), 8, colour.learner, colour.rim);
          }
        },
        grab: (x, y, ask) => {
          const place = to(pane.w), far = handles().map(({at}) => {
            const [u, v] = place(...at);
            return Math.hypot(u - x, v - y);
          });
          const i = far.indexOf(Math.min(...far));
          if (far[i] > 24) return false;
          if (!ask) [chosen, held] = [i, handles()[i]];
          return true;
        },
        drag: (x, y) => move(held, from(pane.w, x, y)),
        keys: {
          Space: () => { chosen = (chosen + 1) % 6; },
          ...window.toys.arrowKeys((dx, dy) => nudge(0.1 * dx, 0.1 * dy)),
        },
      });
      for (const event of ["focus", "blur"]) pane.canvas.addEventListener(event, () => toy.redraw());
    });

    ["violet", "blue"].forEach((name, k) =>
      toy.slider(`weight of ${name}`, {min: 0.05, max: 1, step: 0.05, value: weights[k],
        show: (x) => x.toFixed(2)}, (x) => { weights[k] = x; tell(); }));
    tell();
    return {state: () => ({primitives, weights, chosen})};
  }

  window.toys.products = {compose, density, product, mixture};
  window.toys.definitions.products = define;
})();
