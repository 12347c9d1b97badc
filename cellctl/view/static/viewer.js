// Each measured side as a picture: its points, and on a canvas above them what was fitted. Part frame, millimetres.
const SURFACES = ["face", "chamfer", "wall", "thread", "unused"];
const TOLD = ["face", "chamfer", "wall", "thread", "not used"];
const RANGES_UM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const LIGHT = {
  ground: "#f4f5f7", ink: "#1b1e23", bad: "#a3120c", mark: "#5b21b6", plane: "#3f6fb0",
  low: "#1553b6", middle: "#c6cbd2", high: "#b81f16", far: "#d2c8a4",
  surfaces: ["#8b97a5", "#c77800", "#0072b2", "#00805c", "#d2c8a4"],
};
const DARK = {
  ground: "#20242a", ink: "#eceef1", bad: "#ff9a8f", mark: "#ffd54a", plane: "#7fa8e0",
  low: "#5b9bff", middle: "#6b727c", high: "#ff6b5e", far: "#57512f",
  surfaces: ["#8b97a5", "#f0a030", "#4db2f0", "#2fc296", "#57512f"],
};
const NO_WEBGL = "This browser offers no WebGL, so the points are not drawn; fits and tables are whole.";
const LOST = "The graphics card gave up; load the page again to see the points.";
const form = document.getElementById("controls");
let printing = false;
const palette = () => (!printing && matchMedia("(prefers-color-scheme: dark)").matches ? DARK : LIGHT);

class Picture {
  constructor(section, data) {
    Object.assign(this, { section, data, marked: null });
    this.fits = section.querySelector(".fits");
    this.canvas = section.querySelector(".points");
    this.camera = new Camera(1.15 * Math.max(data.face[1], ...data.features.map(({ centre, mouth }) => Math.hypot(...centre) + mouth)));
    this.points = Points.on(this.canvas, data);
    if (!this.points) this.withoutPoints(NO_WEBGL);
    this.canvas.addEventListener("webglcontextlost", () => this.withoutPoints(LOST));
    this.listen();
    new ResizeObserver(() => this.soon()).observe(this.fits);
  }

  withoutPoints(reason) {
    const notice = this.section.querySelector(".stage .notice");
    notice.textContent = reason;
    notice.hidden = false;
    this.points = null;
    this.soon();
  }

  soon() {
    if (!this.waiting) this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.draw(); });
  }

  draw() {
    const [width, height, dpr] = [this.fits.clientWidth, Math.max(this.fits.clientHeight, 1), window.devicePixelRatio || 1];
    for (const canvas of [this.canvas, this.fits]) {
      const size = [Math.round(width * dpr), Math.round(height * dpr)];
      if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    }
    this.rows = this.camera.rows(width / height);
    const matrix = new Float32Array(16).map((_, at) => this.rows[at % 4][at >> 2]);
    this.points?.draw(matrix, palette(), {
      mode: form.colour.value,
      range: RANGES_UM[form.range.value],
      size: form.size.value * dpr * clamp(Math.sqrt(this.camera.nearness), 1, 3),
      shown: SURFACES.map((name) => Number(form[name].checked)),
      plane: form.plane.checked,
    });
    const pen = this.fits.getContext("2d");
    pen.setTransform(dpr, 0, 0, dpr, 0, 0);
    pen.clearRect(0, 0, width, height);
    this.drawFits(pen, palette());
    if (!printing || !this.points) return;
    // Paper takes one flat picture: a WebGL canvas is not printed everywhere.
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.globalCompositeOperation = "destination-over";
    pen.drawImage(this.canvas, 0, 0);
    pen.globalCompositeOperation = "source-over";
  }

  // Where a place of the part stands on the canvas, null behind the camera.
  place(spot) {
    const [x, y, , w] = this.rows.map((row) => dot(row, spot) + row[3]);
    return w > 0 ? [(0.5 + (0.5 * x) / w) * this.fits.clientWidth, (0.5 - (0.5 * y) / w) * this.fits.clientHeight] : null;
  }

  drawFits(pen, colours) {
    const line = (spots, colour, thick, dash = []) => {
      const path = new Path2D();
      spots.map((spot) => this.place(spot)).forEach((at, number) => at && (number ? path.lineTo(...at) : path.moveTo(...at)));
      for (const [ink, wide, gaps] of [[colours.ground, thick + 2, []], [colour, thick, dash]]) {
        pen.setLineDash(gaps);
        [pen.strokeStyle, pen.lineWidth] = [ink, wide];
        pen.stroke(path);
      }
    };
    const ring = ([x, y, z], radius, ...look) => {
      const angles = Array.from({ length: 49 }, (_, i) => (i * Math.PI) / 24);
      line(angles.map((angle) => [x + radius * Math.cos(angle), y + radius * Math.sin(angle), z]), ...look);
    };
    if (form.plane.checked) for (const radius of this.data.face) ring([0, 0, 0], radius, colours.plane, 1);
    for (const feature of this.data.features) {
      if (feature.found) this.drawFound(feature, colours, line, ring);
      else this.drawMissing(feature, colours, line, ring);
      this.drawNumber(pen, feature, colours);
    }
  }

  drawFound({ index, centre, slopes, radius, mouth, end }, colours, line, ring) {
    const marked = index === this.marked;
    const [colour, thick] = marked ? [colours.mark, 3] : [colours.ink, 1];
    const along = (z) => [centre[0] + slopes[0] * z, centre[1] + slopes[1] * z, z];
    if (form.rings.checked || marked) {
      ring(along(0), mouth, colour, thick);
      if (end > 0) ring(along(end), radius, colour, thick);
      else if (radius < 0.999 * mouth) ring(along(radius - mouth), radius, colour, 1);
    }
    if (form.axes.checked || marked) line([along(end > 0 ? 0 : -0.25 * end), along(end > 0 ? 1.2 * end : end)], colour, marked ? 2 : 1, [8, 3, 2, 3]);
  }

  drawMissing({ index, centre: [x, y], mouth }, colours, line, ring) {
    ring([x, y, 0], mouth, colours.bad, 2, [6, 4]);
    if (index === this.marked) ring([x, y, 0], 1.5 * mouth, colours.mark, 3);
    for (const side of [0.7, -0.7]) line([[x - 0.7 * mouth, y - side * mouth, 0], [x + 0.7 * mouth, y + side * mouth, 0]], colours.bad, 2);
  }

  drawNumber(pen, { index, found, centre, mouth }, colours) {
    if (!form.numbers.checked && found && index !== this.marked) return;
    const outwards = 1 + (2.2 * mouth) / Math.max(Math.hypot(...centre), mouth);
    const spot = this.place([outwards * centre[0], outwards * centre[1], 0]);
    if (!spot) return;
    const text = found ? String(index) : `${index} missing`;
    Object.assign(pen, { font: "12px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", lineWidth: 4, strokeStyle: colours.ground });
    pen.fillStyle = index === this.marked ? colours.mark : found ? colours.ink : colours.bad;
    pen.setLineDash([]);
    pen.strokeText(text, ...spot);
    pen.fillText(text, ...spot);
  }

  mark(index) {
    this.marked = this.marked === index ? null : index;
    for (const row of this.section.querySelectorAll("tr[data-index]")) {
      const mine = Number(row.dataset.index) === this.marked;
      row.classList.toggle("marked", mine);
      row.querySelector("button").setAttribute("aria-pressed", String(mine));
      if (mine) this.tell(row);
    }
    this.section.querySelector("[data-view=closer]").disabled = this.marked === null;
    this.soon();
  }

  // The marked row in words, below the picture.
  tell(row) {
    const heads = [...this.section.querySelectorAll(".features th[scope=col]")].map((cell) => cell.textContent);
    const cells = [...row.children].map((cell) => cell.textContent.trim());
    const whole = cells.length === heads.length;
    this.section.querySelector("output").textContent = cells.map((cell, at) => (whole || !at ? `${heads[at]} ${cell}` : cell)).join(", ");
    const [frame, box] = [row.closest(".scroll").getBoundingClientRect(), row.getBoundingClientRect()];
    row.closest(".scroll").scrollTop += Math.min(box.top - frame.top - 30, 0) + Math.max(box.bottom - frame.bottom, 0);
  }

  look(view) {
    const { index, centre, mouth, end } = this.data.features.find((each) => each.index === this.marked) || {};
    if (view === "closer" && index === undefined) return;
    if (view === "closer") this.camera.look(this.camera.direction, [...centre, Math.max(end, 0) / 2], Math.max(3 * mouth, Math.max(end, 0)));
    else this.camera.look(view === "top" ? Camera.TOP : Camera.SLANT);
    this.soon();
  }

  pick(x, y) {
    const apart = ({ centre, end }) => [0, Math.max(end, 0)].map((z) => this.place([...centre, z]) || [Infinity, 0]).map((at) => Math.hypot(at[0] - x, at[1] - y));
    const [nearest] = this.data.features.map((feature) => [Math.min(...apart(feature)), feature.index]).sort((a, b) => a[0] - b[0]);
    if (nearest && nearest[0] < 24) this.mark(nearest[1]);
  }

  listen() {
    this.section.addEventListener("click", ({ target }) => {
      const row = target.closest("tr[data-index]");
      if (target.dataset.view) this.look(target.dataset.view);
      else if (row) this.mark(Number(row.dataset.index));
    });
    this.fits.addEventListener("keydown", (event) => this.key(event));
    this.fits.addEventListener("contextmenu", (event) => event.preventDefault());
    this.fits.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.move(() => this.camera.zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015)));
    }, { passive: false });
    this.drag(new Map());
  }

  // One finger or button turns, shift or another button moves, two fingers move and zoom; a tap marks.
  drag(fingers) {
    let travel = 0;
    this.fits.addEventListener("pointerdown", (event) => {
      this.fits.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      travel = fingers.size > 1 ? Infinity : 0;
    });
    this.fits.addEventListener("pointermove", (event) => {
      const from = fingers.get(event.pointerId);
      if (!from) return;
      const to = [event.offsetX, event.offsetY];
      const [dx, dy, height] = [to[0] - from[0], to[1] - from[1], this.fits.clientHeight];
      const [, other] = [...fingers].find(([id]) => id !== event.pointerId) || [];
      const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      travel += Math.abs(dx) + Math.abs(dy);
      fingers.set(event.pointerId, to);
      this.move(() => {
        if (other) this.camera.zoom(apart(from) / apart(to));
        if (other) this.camera.shift(dx / 2 / height, dy / 2 / height);
        else if (event.shiftKey || event.buttons & 6) this.camera.shift(dx / height, dy / height);
        else this.camera.turn(dx * 0.008, dy * 0.008);
      });
    });
    for (const kind of ["pointerup", "pointercancel"]) this.fits.addEventListener(kind, (event) => {
      if (fingers.delete(event.pointerId) && kind === "pointerup" && travel < 5) this.pick(event.offsetX, event.offsetY);
    });
  }

  key(event) {
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const act = {
      "+": () => this.camera.zoom(0.85), "=": () => this.camera.zoom(0.85), "-": () => this.camera.zoom(1 / 0.85),
      t: () => this.look("top"), o: () => this.look("slant"), c: () => this.look("closer"), Escape: () => this.mark(this.marked),
    }[event.key];
    if (event.ctrlKey || event.altKey || event.metaKey || !(arrow || act)) return;
    event.preventDefault();
    this.move(act || (() => (event.shiftKey ? this.camera.shift(-0.04 * arrow[0], -0.04 * arrow[1]) : this.camera.turn(0.08 * arrow[0], 0.08 * arrow[1]))));
  }

  move(how) {
    how();
    this.soon();
  }

  legend() {
    const [colours, mode, range] = [palette(), form.colour.value, RANGES_UM[form.range.value]];
    const patch = (kind, background) => Object.assign(document.createElement("span"), { className: kind, style: `background: ${background}` });
    const swatch = (colour, text) => {
      const item = document.createElement("span");
      item.append(patch("swatch", colour), text);
      return item;
    };
    if (mode === "surface") return TOLD.map((text, at) => swatch(colours.surfaces[at], text));
    const ramp = mode === "height" ? [colours.low, colours.middle] : [colours.low, colours.middle, colours.high];
    const bar = patch("bar", `linear-gradient(to right, ${ramp})`);
    if (mode === "residual") return [`−${range} µm`, bar, `+${range} µm (proud of the surface)`, swatch(colours.far, "far from every surface")];
    const [low, high] = (this.points?.heights || [0, 0]).map((each) => each.toFixed(1));
    return [`${low} mm`, bar, `${high} mm above the face`];
  }
}

const sections = document.querySelectorAll(".side");
const pictures = JSON.parse(document.getElementById("data").textContent).map((data, at) => new Picture(sections[at], data));
const redraw = () => {
  document.getElementById("range-told").textContent = RANGES_UM[form.range.value];
  for (const picture of pictures) {
    picture.section.querySelector(".legend").replaceChildren(...picture.legend());
    picture.soon();
  }
};
form.range.value = RANGES_UM.indexOf(Math.max(...pictures.map(({ data }) => data.range_um)));
form.hidden = false;
form.addEventListener("input", redraw);
form.addEventListener("submit", (event) => event.preventDefault());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
for (const [kind, value] of [["beforeprint", true], ["afterprint", false]]) addEventListener(kind, () => {
  printing = value;
  redraw();
  for (const picture of pictures) picture.draw();
});
redraw();
