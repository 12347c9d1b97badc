// Small things that the other scripts share, and the camera that orbits the part (z out of its face).
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

class Camera {
  static HALF_ANGLE = Math.PI / 12;
  static TOP = [-Math.PI / 2, Math.PI / 2];
  static SLANT = [-1.9, 0.75];

  // `extent`: radius in mm of what is worth seeing.
  constructor(extent) {
    this.extent = extent;
    this.look(Camera.SLANT);
  }

  // From a direction (yaw, pitch) at a target, so far that `radius` fills the picture.
  look([yaw, pitch], target = [0, 0, 0], radius = this.extent) {
    Object.assign(this, { yaw, pitch, target, distance: radius / Math.tan(Camera.HALF_ANGLE) });
  }

  get direction() { return [this.yaw, this.pitch]; }

  // How many times nearer than the whole part is seen from.
  get nearness() { return this.extent / Math.tan(Camera.HALF_ANGLE) / this.distance; }

  get axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    return { right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp], back: [cp * cy, cp * sy, sp] };
  }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = clamp(this.pitch + dy, -Math.PI / 2, Math.PI / 2);
  }

  // By a share of the picture's height.
  shift(dx, dy) {
    const { right, up } = this.axes;
    const scale = 2 * this.distance * Math.tan(Camera.HALF_ANGLE);
    this.target = this.target.map((each, axis) => each - scale * (dx * right[axis] - dy * up[axis]));
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 0.05 * this.extent, 30 * this.extent);
  }

  // Rows of the projection of part coordinates.
  rows(aspect) {
    const { right, up, back } = this.axes;
    const eye = back.map((each, axis) => this.target[axis] + this.distance * each);
    const near = Math.max(0.02 * this.distance, this.distance - 3 * this.extent);
    const end = this.distance + 3 * this.extent;
    const focus = Math.min(1, aspect) / Math.tan(Camera.HALF_ANGLE);
    const row = (axis, scale) => [...axis.map((each) => each * scale), -scale * dot(axis, eye)];
    const depth = row(back, (end + near) / (near - end));
    depth[3] += (2 * end * near) / (near - end);
    return [row(right, focus / aspect), row(up, focus), depth, row(back, -1)];
  }
}
