// The points of one side and its fitted face, drawn with WebGL. Positions are whole steps, residuals tenths of a micrometre.
class Points {
  static VERTEX = `
    attribute vec4 point; attribute float surface;
    uniform mat4 camera; uniform float step, size, range, mode; uniform vec2 heights;
    uniform vec3 low, middle, high, far, colours[5]; uniform float shown[5];
    varying vec3 colour;
    void main() {
      float visible = 0.0; vec3 own = far;
      for (int i = 0; i < 5; i++) if (i == int(surface + 0.5)) { visible = shown[i]; own = colours[i]; }
      gl_Position = visible > 0.5 ? camera * vec4(point.xyz * step, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
      gl_PointSize = size;
      float off = clamp(point.w * 0.1 / range, -1.0, 1.0);
      vec3 residual = point.w < -32767.5 ? far : off < 0.0 ? mix(middle, low, -off) : mix(middle, high, off);
      float rise = clamp((point.z * step - heights.x) / (heights.y - heights.x), 0.0, 1.0);
      colour = mode < 0.5 ? residual : mode < 1.5 ? own : mix(low, middle, rise);
    }`;
  static FRAGMENT = `
    precision mediump float; varying vec3 colour; uniform float alpha;
    void main() { gl_FragColor = vec4(colour * alpha, alpha); }`;
  static MODES = ["residual", "surface", "height"];

  // Null where the browser offers no WebGL, or one that cannot run these shaders.
  static on(canvas, data) {
    const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) return null;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, Points.VERTEX], [gl.FRAGMENT_SHADER, Points.FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return gl.getProgramParameter(program, gl.LINK_STATUS) ? new Points(gl, program, data) : null;
  }

  constructor(gl, program, data) {
    Object.assign(this, { gl, program, data });
    gl.useProgram(program);
    this.at = (name) => gl.getUniformLocation(program, name);
    const points = new Int16Array(bytes(data.points).buffer);
    this.heights = Points.span(points.filter((_, at) => at % 4 === 2).sort(), data.step);
    this.cloud = [this.buffer(points), this.buffer(bytes(data.surfaces))];
    const strip = this.annulus();
    this.face = [this.buffer(strip), this.buffer(new Uint8Array(strip.length / 4))];
    this.corners = strip.length / 4;
  }

  // Heights between which all but the outermost hundredths of the points lie, mm.
  static span(sorted, step) {
    const [low, high] = [0.01, 0.99].map((share) => (sorted[Math.floor(share * (sorted.length - 1))] || 0) * step);
    return [low, Math.max(high, low + 0.01)];
  }

  buffer(array) {
    const buffer = this.gl.createBuffer();
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, buffer);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, array, this.gl.STATIC_DRAW);
    return buffer;
  }

  annulus() {
    const strip = [];
    for (let i = 0; i <= 128; i++) for (const radius of this.data.face) {
      const angle = (i * Math.PI) / 64;
      strip.push(radius * Math.cos(angle), radius * Math.sin(angle), 0, 0);
    }
    return new Int16Array(strip.map((each) => clamp(Math.round(each / this.data.step), -32767, 32767)));
  }

  // `look`: mode, range (um), size (px), shown (one flag a surface), plane (whether the fitted face is drawn).
  draw(camera, colours, look) {
    const { gl, at } = this;
    gl.viewport(0, 0, gl.canvas.width, gl.canvas.height);
    gl.clearColor(...rgb(colours.ground), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(at("camera"), false, camera);
    for (const name of ["low", "middle", "high", "far"]) gl.uniform3fv(at(name), rgb(colours[name]));
    gl.uniform3fv(at("colours"), colours.surfaces.flatMap(rgb));
    gl.uniform1fv(at("shown"), look.shown);
    gl.uniform2fv(at("heights"), this.heights);
    gl.uniform1f(at("step"), this.data.step);
    gl.uniform1f(at("range"), look.range);
    gl.uniform1f(at("size"), look.size);
    gl.uniform1f(at("mode"), Points.MODES.indexOf(look.mode));
    this.pass(gl.POINTS, this.cloud, this.data.count, 1);
    if (look.plane) this.drawFace(colours.plane);
  }

  // See-through, so that points below and above it stay in sight.
  drawFace(colour) {
    const { gl, at } = this;
    gl.uniform1f(at("mode"), Points.MODES.indexOf("surface"));
    gl.uniform1fv(at("shown"), [1, 1, 1, 1, 1]);
    gl.uniform3fv(at("colours"), Array(5).fill(rgb(colour)).flat());
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    this.pass(gl.TRIANGLE_STRIP, this.face, this.corners, 0.14);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  pass(kind, [points, surfaces], count, alpha) {
    const { gl } = this;
    for (const [buffer, name, size, type] of [[points, "point", 4, gl.SHORT], [surfaces, "surface", 1, gl.UNSIGNED_BYTE]]) {
      const place = gl.getAttribLocation(this.program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, false, 0, 0);
    }
    gl.uniform1f(this.at("alpha"), alpha);
    gl.drawArrays(kind, 0, count);
  }
}
