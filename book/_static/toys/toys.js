// What all toys share: a palette for light and dark pages, sharp canvases that mouse, finger and
// keyboard can use, controls, and a line that says what has happened. No library, no network.
window.toys = window.toys || (() => {
  // The colours of roles are those of the figures, `plots.py`, on light pages: expert, copy, learner,
  // good (the learned reward) and star. Maps of rewards are dark on all pages, as in the figures.
  const LIGHT = {
    card: "#fffefa", ink: "#25213f", frame: "#25213f", soft: "#635e7d", line: "#e4dff0", floor: "#f6f3ff",
    expert: "#5a1fd6", copy: "#2f7fd0", learner: "#ffc21a", wall: "#f2545b", good: "#009e73", policy: "#c75f00",
    rim: "#25213f", star: "#ff4d9d", button: "#efeaff", pressed: "#6c3df4", onPressed: "#ffffff",
    reward: ["#f6f3ff", "#dcf6ea", "#9ee8cb", "#45cda6", "#0aa587", "#00756a"],
    penalty: ["#f6f3ff", "#f2545b"],
    visits: ["#f6f3ff", "#dcd0ff", "#b194ff", "#8457ff", "#5a1fd6"],
    difference: ["#e06b00", "#ff9f2e", "#ffd9a0", "#f6f3ff", "#cdb9ff", "#9166ff", "#5a1fd6"],
  };
  const DARK = {
    card: "#1d1b2e", ink: "#f3f0ff", frame: "#f3f0ff", soft: "#b9b3d3", line: "#3a3655", floor: "#262340",
    expert: "#9670ff", copy: "#86d6ff", learner: "#ffce45", wall: "#ff7b7b", good: "#4fe0b0", policy: "#ffb04d",
    rim: "#0f0d1c", star: "#ff79b8", button: "#352f57", pressed: "#a98bff", onPressed: "#17142b",
    reward: ["#262340", "#22454f", "#1c6f6b", "#1d9c82", "#45cf9d", "#b6ffd9"],
    penalty: ["#262340", "#ff7b7b"],
    visits: ["#262340", "#433679", "#6a4fc4", "#9c7dff", "#d9ccff"],
    difference: ["#ffb04d", "#d97a12", "#7a4b22", "#262340", "#4d3d8c", "#8562ef", "#c4aeff"],
  };
  const all = [], definitions = {};
  const matches = (query) => window.matchMedia(query).matches;
  const calm = () => matches("(prefers-reduced-motion: reduce)");

  function dark() {
    const theme = document.documentElement.dataset.theme;
    if (theme) return theme === "dark";
    const lab = document.body.dataset.jpThemeLight;
    if (lab) return lab === "false";
    return matches("(prefers-color-scheme: dark)");
  }

  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
      else if (value !== undefined && value !== false) made.setAttribute(name, value);
    }
    made.append(...children);
    return made;
  }

  const channels = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const scales = new WeakMap();

  // The colour of a number from 0 to 1 between the colours of a list.
  function shade(colours, x) {
    if (!scales.has(colours)) scales.set(colours, Array.from({length: 256}, (_, k) => {
      const at = (k / 255) * (colours.length - 1), i = Math.min(colours.length - 2, Math.floor(at));
      const [a, b] = [channels(colours[i]), channels(colours[i + 1])];
      return `rgb(${a.map((c, j) => Math.round(c + (at - i) * (b[j] - c))).join(",")})`;
    }));
    return scales.get(colours)[Math.round(255 * Math.min(1, Math.max(0, x || 0)))];
  }

  function text(ctx, words, x, y, {size = 13, colour, align = "center", weight = 600, halo} = {}) {
    ctx.font = `${weight} ${Math.max(12, size)}px system-ui, -apple-system, sans-serif`;
    ctx.textAlign = align;
    ctx.textBaseline = "middle";
    if (halo) {
      ctx.lineJoin = "round";
      ctx.lineWidth = 4;
      ctx.strokeStyle = halo;
      ctx.strokeText(words, x, y);
    }
    ctx.fillStyle = colour;
    ctx.fillText(words, x, y);
  }

  function line(ctx, points, colour, width = 2, {dash = [], alpha = 1} = {}) {
    ctx.save();
    ctx.globalAlpha = alpha;
    ctx.setLineDash(dash);
    ctx.lineJoin = ctx.lineCap = "round";
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.beginPath();
    points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
    ctx.stroke();
    ctx.restore();
  }

  function dot(ctx, x, y, radius, fill, rim, width = 2) {
    ctx.beginPath();
    ctx.arc(x, y, radius, 0, 2 * Math.PI);
    ctx.fillStyle = fill;
    ctx.fill();
    if (!rim) return;
    ctx.lineWidth = width;
    ctx.strokeStyle = rim;
    ctx.stroke();
  }

  function star(ctx, x, y, radius, fill, rim) {
    ctx.beginPath();
    for (let k = 0; k < 10; k++) {
      const far = k % 2 ? radius * 0.45 : radius, angle = (k * Math.PI) / 5 - Math.PI / 2;
      ctx.lineTo(x + far * Math.cos(angle), y + far * Math.sin(angle));
    }
    ctx.closePath();
    ctx.lineJoin = "round";
    ctx.fillStyle = fill;
    ctx.fill();
    ctx.lineWidth = 1.5;
    ctx.strokeStyle = rim;
    ctx.stroke();
  }

  // An arrow by its two ends; its head is as large as `head`.
  function arrow(ctx, [x, y], [u, v], colour, width = 2, head = 6) {
    const angle = Math.atan2(v - y, u - x), back = 0.8 * head;
    line(ctx, [[x, y], [u - back * Math.cos(angle), v - back * Math.sin(angle)]], colour, width);
    ctx.beginPath();
    for (const [far, turn] of [[0, 0], [head * 1.4, 2.7], [head * 1.4, -2.7]])
      ctx.lineTo(u + far * Math.cos(angle + turn), v + far * Math.sin(angle + turn));
    ctx.closePath();
    ctx.fillStyle = colour;
    ctx.fill();
  }

  // Axes of a plot: `box` in pixels, `range` as [left, right, bottom, top] in numbers; `yShow`
  // names the numbers of `y`.
  function axes(ctx, box, range, colour,
    {x = [], y = [], xLabel = "", yLabel = "", yShow = (v) => `${v}`.replace("-", "−")} = {}) {
    const [left, right, bottom, top] = range;
    const to = (u, v) => [box.x + ((u - left) / (right - left)) * box.w,
      box.y + box.h - ((v - bottom) / (top - bottom)) * box.h];
    for (const v of y) line(ctx, [to(left, v), to(right, v)], colour.line, 1);
    line(ctx, [to(left, bottom), to(right, bottom)], colour.soft, 1);
    const look = {size: 12, colour: colour.soft, weight: 500};
    for (const u of x) text(ctx, `${u}`.replace("-", "−"), to(u, bottom)[0], box.y + box.h + 11, look);
    for (const v of y)
      text(ctx, yShow(v), box.x - 6, to(left, v)[1], {...look, align: "right"});
    if (xLabel) text(ctx, xLabel, box.x + box.w, box.y + box.h + 27, {...look, align: "right"});
    if (yLabel) text(ctx, yLabel, box.x, box.y - 11, {...look, align: "left"});
    return to;
  }

  // A map of wide × high colours, row by row from the top: `colours(shade, ...of)` fills it, but not
  // again for the same `of`; `draw` spreads it over a box.
  function raster(wide, high) {
    const image = element("canvas", {width: wide, height: high}), brush = image.getContext("2d");
    let made = [];
    return {
      colours: (shade, ...of) => {
        if (of.length && of.every((x, i) => x === made[i])) return;
        made = of;
        for (let i = 0; i < wide * high; i++) {
          brush.fillStyle = shade(i);
          brush.fillRect(i % wide, Math.floor(i / wide), 1, 1);
        }
      },
      draw: (ctx, {x, y, w, h}, smooth = true) => {
        ctx.imageSmoothingEnabled = smooth;
        ctx.imageSmoothingQuality = "high";
        ctx.drawImage(image, x, y, w, h);
      },
    };
  }

  // The four arrow keys: `act(dx, dy, event)`, up being positive.
  const arrowKeys = (act) => Object.fromEntries([["Left", -1, 0], ["Right", 1, 0], ["Up", 0, 1], ["Down", 0, -1]]
    .map(([name, dx, dy]) => [`Arrow${name}`, (event) => act(dx, dy, event)]));

  class Toy {
    constructor(root) {
      this.root = root;
      this.panes = [];
      this.stage = element("div", {class: "toy-stage"});
      this.bar = element("div", {class: "toy-bar"});
      this.said = element("p", {class: "toy-says", "aria-live": "polite"});
      root.append(this.stage, this.said, this.bar);
      root.classList.add("toy-live");
      // In JupyterLab keys are commands, such as "delete the cell".
      root.setAttribute("data-lm-suppress-shortcuts", "true");
      this.visible = true;
      new IntersectionObserver((seen) => {
        this.visible = seen[seen.length - 1].isIntersecting;
      }).observe(root);
      this.recolour();
    }

    recolour() {
      this.colour = dark() ? DARK : LIGHT;
      for (const [name, value] of Object.entries(this.colour))
        if (typeof value === "string") this.root.style.setProperty(`--toy-${name}`, value);
      this.root.style.setProperty("--toy-ramp", `linear-gradient(90deg, ${DARK.reward})`);
      this.redraw();
    }

    redraw() {
      if (this.waiting) return;
      this.waiting = requestAnimationFrame(() => {
        this.waiting = 0;
        this.panes.forEach((pane) => pane.paint());
      });
    }

    // What has happened, read aloud unless it is one of many steps.
    say(words, quiet = false) {
      this.said.setAttribute("aria-live", quiet ? "off" : "polite");
      words = words.replace(/(\d) %/g, "$1\u00a0%"); // in one line
      if (this.said.textContent !== words) this.said.textContent = words;
    }

    // A picture: `draw(ctx, w, h, colour)` paints it, as high as `ratio` times its width, or `narrow` times on a phone.
    // `grab(x, y)` says whether a drag begins there; `drag(x, y)` and `drop(x, y)` follow.
    // `keys[name]` are functions of the key's event; `label` and `help` are read aloud. `scale` names
    // both ends of the colours of a map of rewards.
    pane({label, help = "", title, caption, scale, ratio = 1, narrow = ratio, draw, grab, drag, drop, keys, shape = ""}) {
      const canvas = element("canvas", {
        role: grab || keys ? "application" : "img", "aria-label": `${label} ${help}`.trim(),
        ...(grab || keys ? {tabindex: 0} : {}),
      });
      canvas.style.setProperty("--toy-ratio", ratio);
      canvas.style.setProperty("--toy-narrow", narrow);
      const figure = element("div", {class: `toy-pane ${shape}`});
      if (title) figure.append(element("p", {class: "toy-title"}, title));
      figure.append(canvas);
      if (caption) figure.append(element("p", {class: "toy-caption"}));
      if (caption) figure.lastChild.innerHTML = caption;
      if (scale) figure.append(element("p", {class: "toy-scale"}, scale[0], element("span"), scale[1]));
      this.stage.append(figure);
      const ctx = canvas.getContext("2d");
      const pane = {canvas, figure, w: 0, h: 0, paint: () => {
        const w = canvas.clientWidth, h = canvas.clientHeight;
        const sharp = window.devicePixelRatio || 1;
        if (!w || !h) return;
        if (canvas.width !== Math.round(w * sharp) || canvas.height !== Math.round(h * sharp)) {
          canvas.width = Math.round(w * sharp);
          canvas.height = Math.round(h * sharp);
        }
        [pane.w, pane.h] = [w, h];
        ctx.setTransform(sharp, 0, 0, sharp, 0, 0);
        ctx.clearRect(0, 0, w, h);
        // A map is dark on every page; its frame, and words beside it, are on the page.
        draw(ctx, w, h, scale ? {...DARK, frame: this.colour.frame} : this.colour);
      }};
      new ResizeObserver(() => this.redraw()).observe(canvas);
      if (grab) this.draggable(canvas, {grab, drag, drop});
      if (keys) canvas.addEventListener("keydown", (event) => {
        const act = keys[event.key === " " ? "Space" : event.key];
        if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        event.stopPropagation();
        act(event);
        this.redraw();
      });
      this.panes.push(pane);
      return pane;
    }

    draggable(canvas, {grab, drag, drop}) {
      const place = (event) => {
        const box = canvas.getBoundingClientRect();
        return [event.clientX - box.left, event.clientY - box.top];
      };
      let held = null;
      canvas.addEventListener("pointerdown", (event) => {
        if (held !== null || !grab(...place(event))) return;
        held = event.pointerId;
        canvas.setPointerCapture(held);
        canvas.focus({preventScroll: true, focusVisible: false});
        event.preventDefault();
        this.redraw();
      });
      // A finger that grabs nothing scrolls the page.
      canvas.addEventListener("touchstart", (event) => {
        const [touch] = event.changedTouches;
        if (event.cancelable && grab(...place(touch), true)) event.preventDefault();
      }, {passive: false});
      canvas.addEventListener("pointermove", (event) => {
        const at = place(event);
        if (held === null) canvas.style.cursor = grab(...at, true) ? "grab" : "";
        if (event.pointerId !== held) return;
        drag(...at);
        this.redraw();
      });
      const end = (event) => {
        if (event.pointerId !== held) return;
        held = null;
        if (drop) drop(...place(event));
        this.redraw();
      };
      canvas.addEventListener("pointerup", end);
      canvas.addEventListener("pointercancel", end);
    }

    button(words, act, {strong = false, label} = {}) {
      const made = element("button", {
        type: "button", class: strong ? "toy-strong" : false, "aria-label": label,
        onclick: () => { act(); this.redraw(); },
      }, words);
      this.bar.append(made);
      return made;
    }

    slider(words, {min, max, step = 1, value, show = (x) => `${x}`}, act) {
      const out = element("output");
      const input = element("input", {type: "range", min, max, step, "aria-label": words});
      const set = (x) => {
        input.value = x;
        out.textContent = show(+input.value);
        input.setAttribute("aria-valuetext", out.textContent);
      };
      set(value);
      input.addEventListener("input", () => { set(+input.value); act(+input.value); this.redraw(); });
      this.bar.append(element("label", {class: "toy-slider"}, element("span", {}, words), input, out));
      return {input, set};
    }

    // One of several: `options` maps names to what is shown.
    choice(words, options, value, act) {
      const name = `toy-${all.length}-${this.bar.children.length}`;
      const group = element("div"); // As a whole below the words, where there is no room beside them.
      for (const [key, shown] of Object.entries(options)) {
        const input = element("input", {type: "radio", name, value: key});
        input.checked = key === value;
        input.addEventListener("change", () => { act(key); this.redraw(); });
        group.append(element("label", {}, input, element("span", {}, shown)));
      }
      this.bar.append(element("fieldset", {class: "toy-choice"}, element("legend", {}, words), group));
      return {set: (key) => group.querySelectorAll("input").forEach((i) => (i.checked = i.value === key))};
    }

    // Buttons for a game in rounds, each of which is played by `step`; `over` says when it has ended,
    // and `pause` how many seconds a round is seen. `restart(true)` gives up what was drawn, too.
    rounds({step, restart, over, pause = 0}) {
      const game = {playing: false, finish: () => { while (!over()) step(); }};
      let wait = 0;
      this.button("Play", () => { if (over()) restart(); game.playing = true; }, {strong: true});
      this.button("One round", () => { game.playing = false; step(); });
      this.button("Restart", () => { game.playing = false; restart(true); });
      this.play((passed) => {
        wait += passed;
        if (!game.playing || wait < pause) return undefined;
        wait = 0;
        step();
        if (over()) game.playing = false;
        return true;
      });
      return game;
    }

    // Call `frame(seconds)` before each picture while the toy is seen, until it returns false; the
    // toy is drawn again if it returns true.
    play(frame) {
      let before = null;
      const next = (now) => {
        if (!this.root.isConnected) return;
        const passed = before === null ? 0 : Math.min(0.1, (now - before) / 1000);
        before = now;
        const more = this.visible ? frame(passed) : undefined;
        if (more !== undefined) this.redraw();
        if (more === false) return;
        requestAnimationFrame(next);
      };
      requestAnimationFrame(next);
    }
  }

  function start() {
    for (const root of document.querySelectorAll(".toy:not(.toy-live)")) {
      const define = definitions[root.dataset.toy];
      if (!define) continue;
      const toy = new Toy(root);
      all.push(toy);
      Object.assign(toy, define(toy));
      toy.redraw();
    }
  }

  const recolour = () => all.forEach((toy) => toy.recolour());
  new MutationObserver(recolour).observe(document.documentElement, {attributeFilter: ["data-theme"]});
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  const whenReady = () => new MutationObserver(recolour)
    .observe(document.body, {attributeFilter: ["data-jp-theme-light"]});
  if (document.body) whenReady();
  else window.addEventListener("DOMContentLoaded", whenReady);

  return {all, definitions, start, calm, element, shade, text, line, dot, star, arrow, axes, raster,
    arrowKeys};
})();
