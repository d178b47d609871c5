"use strict";
// Draws recorded walks with WebGL and their margins with a 2D canvas. DATA is a list of walks, one or two.
(() => {
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const buffer = (text) => bytes(text).buffer;
  const floats = (text) => new Float32Array(buffer(text));
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const HERE = { p: [0, 0, 0], r: [1, 0, 0, 0] };  // no motion
  const looks = getComputedStyle(document.documentElement), css = (name) => looks.getPropertyValue(`--${name}`).trim();
  const rgba = (name, a = 1) => [...[1, 3, 5].map((k) => parseInt(css(name).slice(k, k + 2), 16) / 255), a];

  // ---- meshes: positions and normals, as triangles
  const box = () => {
    const out = [];
    for (let axis = 0; axis < 3; axis++) for (const s of [1, -1]) {
      const n = [0, 0, 0]; n[axis] = s;
      const u = [0, 0, 0], v = [0, 0, 0]; u[(axis + 1) % 3] = 0.5; v[(axis + 2) % 3] = 0.5 * s;
      const c = (a, b) => [0, 1, 2].map((k) => n[k] / 2 + a * u[k] + b * v[k]);
      for (const p of [c(-1, -1), c(1, -1), c(1, 1), c(-1, -1), c(1, 1), c(-1, 1)]) out.push(...p, ...n);
    }
    return out;
  };
  const cylinder = () => {
    const out = [], N = 36;
    for (let i = 0; i < N; i++) {
      const a = 2 * Math.PI * i / N, b = 2 * Math.PI * (i + 1) / N;
      const A = [Math.cos(a), Math.sin(a)], B = [Math.cos(b), Math.sin(b)];
      for (const [q, z] of [[A, -0.5], [B, -0.5], [B, 0.5], [A, -0.5], [B, 0.5], [A, 0.5]]) out.push(q[0], q[1], z, q[0], q[1], 0);
      for (const s of [1, -1]) {
        const [P, Q] = s > 0 ? [A, B] : [B, A];
        out.push(0, 0, s / 2, 0, 0, s, ...P, s / 2, 0, 0, s, ...Q, s / 2, 0, 0, s);
      }
    }
    return out;
  };
  const sphere = () => {
    const out = [], N = 20, M = 12;
    const p = (i, j) => { const a = 2 * Math.PI * i / N, b = Math.PI * (j / M - 0.5); return [Math.cos(b) * Math.cos(a), Math.cos(b) * Math.sin(a), Math.sin(b)]; };
    for (let i = 0; i < N; i++) for (let j = 0; j < M; j++)
      for (const [a, b] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) { const v = p(i + a, j + b); out.push(...v, ...v); }
    return out;
  };

  const triangles = (shape) => {  // each with its own normal
    const v = floats(shape.v), f = new Uint32Array(buffer(shape.f)), out = [];
    for (let i = 0; i < f.length; i += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => [...v.subarray(3 * f[i + k], 3 * f[i + k] + 3)]), n = unit(cross(sub(b, a), sub(c, a)));
      for (const p of [a, b, c]) out.push(...p, ...n);
    }
    return out;
  };

  class Stage {
    constructor(canvas, walk) {
      this.canvas = canvas; this.walk = walk;
      const gl = this.gl = canvas.getContext("webgl", { alpha: false, antialias: true, preserveDrawingBuffer: true });
      if (!gl) { canvas.replaceWith(Object.assign(document.createElement("p"), { textContent: "This browser has no WebGL: no replay." })); return; }
      const build = (type, text) => { const s = gl.createShader(type); gl.shaderSource(s, text); gl.compileShader(s); return s; };
      const program = this.program = gl.createProgram();
      gl.attachShader(program, build(gl.VERTEX_SHADER, `
        attribute vec3 p; attribute vec3 n; uniform mat4 view; uniform vec4 r, rs; uniform vec3 o, os, s;
        varying vec3 normal; varying vec3 place;
        vec3 turn(vec4 q, vec3 v) { vec3 t = 2.0 * cross(q.yzw, v); return v + q.x * t + cross(q.yzw, t); }
        void main() { normal = turn(r, turn(rs, n / s)); place = turn(r, turn(rs, p * s) + os) + o; gl_Position = view * vec4(place, 1.0); }`));
      gl.attachShader(program, build(gl.FRAGMENT_SHADER, `
        precision mediump float; varying vec3 normal; varying vec3 place; uniform vec4 color; uniform float lit; uniform vec3 eye; uniform float far;
        void main() {
          vec3 n = normalize(normal + vec3(1e-9)); float sun = max(dot(n, normalize(vec3(0.5, 0.35, 0.8))), 0.0);
          float shade = mix(1.0, 0.50 + 0.16 * n.z + 0.46 * sun, lit);
          float fog = lit > 0.5 ? 0.0 : clamp((distance(place, eye) - far) / (1.25 * far), 0.0, 1.0) * step(color.a, 0.99);
          gl_FragColor = vec4(mix(color.rgb * shade, vec3(1.0), fog), color.a * (1.0 - fog)); }`));
      gl.linkProgram(program); gl.useProgram(program);
      this.u = {}; for (const k of ["view", "r", "o", "rs", "os", "s", "color", "lit", "eye", "far"]) this.u[k] = gl.getUniformLocation(program, k);
      this.mesh = {};
      const meshes = walk.shapes.filter((s) => s.k === "mesh");
      meshes.forEach((s, i) => { s.k = `mesh${i}`; });
      for (const [k, f] of [["box", box], ["cylinder", cylinder], ["sphere", sphere], ...meshes.map((s) => [s.k, () => triangles(s)])]) {
        const v = f(), b = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, b);
        gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(v), gl.STATIC_DRAW); this.mesh[k] = { b, n: v.length / 6 };
      }
      this.lines = gl.createBuffer();
      gl.enable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      this.yaw = 0.65; this.pitch = 0.32; this.away = 0;
      this.mouse();
    }
    mouse() {
      const c = this.canvas; let last = null;
      c.onpointerdown = (e) => { last = [e.clientX, e.clientY]; c.setPointerCapture(e.pointerId); };
      c.onpointerup = () => { last = null; };
      c.onpointermove = (e) => {
        if (!last) return;
        this.yaw -= (e.clientX - last[0]) * 0.008; this.pitch = Math.min(1.5, Math.max(-0.1, this.pitch + (e.clientY - last[1]) * 0.006));
        last = [e.clientX, e.clientY]; redraw();
      };
      c.onwheel = (e) => { e.preventDefault(); this.away *= Math.exp(e.deltaY * 0.001); redraw(); };
    }
    camera(center) {
      const c = this.canvas, w = c.clientWidth * devicePixelRatio, h = c.clientHeight * devicePixelRatio;
      if (c.width !== w || c.height !== h) { c.width = w; c.height = h; }
      const d = this.away, eye = [center[0] + d * Math.cos(this.pitch) * Math.cos(this.yaw), center[1] + d * Math.cos(this.pitch) * Math.sin(this.yaw), center[2] + d * Math.sin(this.pitch)];
      const f = unit(sub(center, eye)), s = unit(cross(f, [0, 0, 1])), u = cross(s, f);
      const k = 1 / Math.tan(0.35), a = w / h, n = 0.02, z = 30;
      const V = [[s[0], u[0], -f[0]], [s[1], u[1], -f[1]], [s[2], u[2], -f[2]], [-dot(s, eye), -dot(u, eye), dot(f, eye)]];
      const m = []; for (const col of V) m.push(col[0] * k / a, col[1] * k, col[2] * (z + n) / (n - z), -col[2]);
      m[14] += 2 * z * n / (n - z);
      this.gl.uniformMatrix4fv(this.u.view, false, m); this.gl.uniform3fv(this.u.eye, eye); this.gl.uniform1f(this.u.far, d); this.gl.viewport(0, 0, w, h);
    }
    place(pose, own) {  // a body, and what is drawn in its frame
      const gl = this.gl; gl.uniform4fv(this.u.r, pose.r); gl.uniform3fv(this.u.o, pose.p); gl.uniform4fv(this.u.rs, own.r); gl.uniform3fv(this.u.os, own.p);
    }
    solid(kind, pose, size, color, own = HERE) {
      const gl = this.gl, m = this.mesh[kind]; gl.bindBuffer(gl.ARRAY_BUFFER, m.b); this.attributes(24);
      this.place(pose, own); gl.uniform3fv(this.u.s, size);
      gl.uniform4fv(this.u.color, color); gl.uniform1f(this.u.lit, 1); gl.drawArrays(gl.TRIANGLES, 0, m.n);
    }
    attributes(stride) {
      const gl = this.gl, p = gl.getAttribLocation(this.program, "p"), n = gl.getAttribLocation(this.program, "n");
      gl.enableVertexAttribArray(p); gl.vertexAttribPointer(p, 3, gl.FLOAT, false, stride, 0);
      if (stride === 24) { gl.enableVertexAttribArray(n); gl.vertexAttribPointer(n, 3, gl.FLOAT, false, 24, 12); } else { gl.disableVertexAttribArray(n); gl.vertexAttrib3f(n, 0, 0, 1); }
    }
    flat(mode, points, color) {
      const gl = this.gl; gl.bindBuffer(gl.ARRAY_BUFFER, this.lines); gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points.flat()), gl.STREAM_DRAW); this.attributes(12);
      this.place(HERE, HERE); gl.uniform3fv(this.u.s, [1, 1, 1]);
      gl.uniform4fv(this.u.color, color); gl.uniform1f(this.u.lit, 0); gl.drawArrays(mode, 0, points.length);
    }
    ribbon(points, width, color) {
      const strip = [];
      for (let i = 0; i < points.length; i++) {
        const a = points[Math.max(i - 1, 0)], b = points[Math.min(i + 1, points.length - 1)], t = unit([b[0] - a[0], b[1] - a[1], 0]);
        strip.push([points[i][0] - t[1] * width, points[i][1] + t[0] * width, points[i][2]], [points[i][0] + t[1] * width, points[i][1] - t[0] * width, points[i][2]]);
      }
      if (strip.length > 2) this.flat(this.gl.TRIANGLE_STRIP, strip, color);
    }
    draw(t) {
      const gl = this.gl; if (!gl) return;
      const w = this.walk, now = w.state(t), ground = now.ground;
      if (!this.away) this.away = 2.2 * Math.max(w.height, 0.2);
      const com = now.com, middle = [com[0], com[1], ground + 0.5 * w.height];
      gl.clearColor(0.985, 0.988, 0.992, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); this.camera(middle);
      const grid = [], cell = 0.05, cx = Math.round(com[0] / cell), cy = Math.round(com[1] / cell), N = 50;
      for (let i = -N; i <= N; i++) grid.push([(cx + i) * cell, (cy - N) * cell, ground - 0.002], [(cx + i) * cell, (cy + N) * cell, ground - 0.002], [(cx - N) * cell, (cy + i) * cell, ground - 0.002], [(cx + N) * cell, (cy + i) * cell, ground - 0.002]);
      this.flat(gl.LINES, grid, [0.62, 0.67, 0.72, 0.75]);
      const red = rgba("com"), ring = (corners, up, width, color) => this.ribbon([...corners, corners[0]].map((c) => [c[0], c[1], c[2] + up]), width, color);
      for (const p of w.prints) if (p.t <= t + 1e-6) ring(p.c, 0, 0.0012, rgba(p.foot));
      const target = now.phase.target;
      if (target) { this.flat(gl.TRIANGLE_FAN, target.c, rgba(target.foot, 0.3)); ring(target.c, 0.0005, 0.0012, rgba(target.foot)); }
      this.flat(gl.TRIANGLE_FAN, now.polygon.map((c) => [c[0], c[1], c[2] + 0.001]), rgba("good", 0.16));
      ring(now.polygon, 0.001, 0.0015, now.inside ? rgba("ink") : red);
      this.ribbon(w.way(t).map((c) => [c[0], c[1], ground + 0.002]), 0.0013, red);
      for (const s of w.shapes) {
        const size = s.k === "cylinder" ? [s.s[0], s.s[0], s.s[1]] : s.k === "sphere" ? [s.s[0], s.s[0], s.s[0]] : s.s;
        this.solid(s.k, now.body(s.b), size, s.c, s);
      }
      const at = (p) => ({ ...HERE, p });
      this.solid("sphere", at(com), [0.011, 0.011, 0.011], red);
      for (const mark of w.marks) {
        const p = now.values(mark.v);
        if (!p.some(Number.isNaN)) this.solid(mark.disc ? "cylinder" : "sphere", at(p), mark.disc ? [0.008, 0.008, 0.006] : [0.022, 0.022, 0.022], [...mark.color, 1]);
      }
      this.solid("cylinder", at([com[0], com[1], (com[2] + ground) / 2]), [0.001, 0.001, com[2] - ground], red);
      this.solid("cylinder", at([com[0], com[1], ground + 0.002]), [0.008, 0.008, 0.002], red);
      gl.depthMask(false);  // the regions are transparent
      for (const region of w.regions) {
        const v = now.values(region.v);
        if (v.some(Number.isNaN)) continue;
        const [x, y, z] = v.slice(7), size = region.kind === "cylinder" ? [x / 2, y / 2, z] : [x, y, z].map((e) => Math.max(e, 0.0012));
        this.solid(region.kind, { p: v.slice(0, 3), r: v.slice(3, 7) }, size, region.name === now.tight ? rgba("tight", 0.3) : [...region.color, 0.22]);
      }
      gl.depthMask(true);
    }
  }

  class Walk {
    constructor(d) {
      Object.assign(this, d);
      for (const k of ["t", "bodies", "com"]) this[k] = floats(d[k]);
      const points = floats(d.polygons.v); let first = 0;
      this.polygons = Array.from(bytes(d.polygons.counts), (n) => Array.from({ length: n }, () => [...points.subarray(first, first += 3)]));
      this.curves = d.curves.map((c) => ({ ...c, v: floats(c.v) }));
      this.marks = d.marks.map((m) => ({ ...m, v: floats(m.v) }));
      this.regions = d.regions.map((r) => ({ ...r, v: floats(r.v) }));
      this.inside = this.curves.find((c) => c.name === "support_polygon");
      this.tightAt = bytes(d.tight.at);
      this.end = this.t[this.t.length - 1];
    }
    row(t) { let a = 0, b = this.t.length - 1; while (b - a > 1) { const m = (a + b) >> 1; if (this.t[m] <= t) a = m; else b = m; } return t >= this.t[b] ? b : a; }
    phase(t) { let k = 0; while (k + 1 < this.phases.length && this.phases[k + 1].t <= t + 1e-6) k++; return this.phases[k]; }
    way(t) { const out = [], n = this.row(t); const step = Math.max(1, n >> 9); for (let i = 0; i <= n; i += step) out.push([...this.com.subarray(3 * i, 3 * i + 3)]); return out; }
    state(t) {
      const i = this.row(t), j = Math.min(i + 1, this.t.length - 1), span = this.t[j] - this.t[i];
      const f = span > 0 ? Math.min(1, Math.max(0, (t - this.t[i]) / span)) : 0;
      const mix = (a, k) => { const w = a.length / this.t.length; return (1 - f) * a[i * w + k] + f * a[j * w + k]; };
      const mixed = (a, k, n) => Array.from({ length: n }, (_, c) => mix(a, k + c));
      const body = (b) => { const r = mixed(this.bodies, 7 * b + 3, 4), norm = Math.hypot(...r); return { p: mixed(this.bodies, 7 * b, 3), r: r.map((v) => v / norm) }; };
      const values = (v) => {  // those of frame i where frame j has none
        const n = v.length / this.t.length, a = [...v.subarray(i * n, (i + 1) * n)], b = mixed(v, 0, n);
        return b.some(Number.isNaN) ? a : b;
      };
      const polygon = this.polygons[i], ground = polygon.reduce((sum, c) => sum + c[2] / polygon.length, 0);
      const inside = !this.inside || this.inside.v[i] >= 0, tight = this.tight.names[this.tightAt[i]];
      return { body, values, com: mixed(this.com, 0, 3), ground, polygon, inside, tight, phase: this.phase(t) };
    }
  }

  // ---- margins: one small curve each, the tightest marked
  class Curves {
    constructor(root, walk) {
      this.walk = walk;
      this.rows = walk.curves.map((curve) => {
        const row = document.createElement("div"); row.className = "curve"; row.dataset.name = curve.name;
        row.innerHTML = `<span></span><b></b><canvas></canvas>`; row.firstChild.textContent = curve.title;
        row.onclick = (e) => { const c = row.lastChild.getBoundingClientRect(); seek(walk.end * (e.clientX - c.left) / c.width); };
        root.append(row); return { row, curve, value: row.children[1], canvas: row.lastChild };
      });
    }
    draw(t) {
      const w = this.walk, i = w.row(t), tight = w.tight.names[w.tightAt[i]];
      for (const { row, curve, value, canvas } of this.rows) {
        const v = curve.v[i], known = !Number.isNaN(v);
        row.classList.toggle("tight", curve.name === tight); row.classList.toggle("absent", !known);
        value.textContent = known ? `${v.toFixed(2)} ${curve.unit}` : "–"; value.style.color = v < 0 ? css("bad") : "";
        const W = canvas.width = canvas.clientWidth * devicePixelRatio, H = canvas.height = canvas.clientHeight * devicePixelRatio;
        const g = canvas.getContext("2d"), all = curve.v.filter((x) => !Number.isNaN(x));
        let low = 0, high = 1e-6; for (const x of all) { low = Math.min(low, x); high = Math.max(high, x); }
        const room = 0.08 * (high - low); low -= room; high += room;
        const X = (s) => W * s / w.end, Y = (x) => H * (1 - (x - low) / (high - low));
        g.fillStyle = "#f1f4f7"; w.phases.forEach((p, k) => { if (p.double) g.fillRect(X(p.t), 0, X((w.phases[k + 1] || { t: w.end }).t) - X(p.t), H); });
        g.strokeStyle = css("bad"); g.setLineDash([5, 4]); g.beginPath(); g.moveTo(0, Y(0)); g.lineTo(W, Y(0)); g.stroke(); g.setLineDash([]);
        g.strokeStyle = css(curve.name === tight ? "tight" : "blue"); g.lineWidth = 1.6 * devicePixelRatio; g.beginPath();
        let pen = false; for (let k = 0; k < w.t.length; k++) { const x = curve.v[k]; if (Number.isNaN(x)) { pen = false; continue; } if (pen) g.lineTo(X(w.t[k]), Y(x)); else g.moveTo(X(w.t[k]), Y(x)); pen = true; } g.stroke();
        g.strokeStyle = css("ink"); g.lineWidth = devicePixelRatio; g.beginPath(); g.moveTo(X(t), 0); g.lineTo(X(t), H); g.stroke();
      }
    }
  }

  const DATA = JSON.parse(document.getElementById("data").textContent), walks = DATA.map((d) => new Walk(d));
  const stages = walks.map((w, k) => new Stage(document.getElementById(`stage${k}`), w));
  const curves = walks.map((w, k) => new Curves(document.getElementById(`curves${k}`), w));
  const $ = (id) => document.getElementById(id), end = Math.max(...walks.map((w) => w.end));
  const slider = $("time"), play = $("play"), speed = $("speed"); slider.max = end; slider.step = end / 2000;
  speed.value = end > 90 ? "10" : "1";
  let now = 0, playing = false, last = 0, drawn = 0;
  const redraw = () => {
    walks.forEach((w, k) => { const t = Math.min(now, w.end); stages[k].draw(t); curves[k].draw(t); $(`phase${k}`).textContent = w.phase(t).name.replace("_", " ").replace("/", ", ") ; });
    $("clock").textContent = `${now.toFixed(2)} s`; slider.value = now; window.dqwalkDrawn = ++drawn;
  };
  const seek = (t) => { now = Math.min(end, Math.max(0, t)); redraw(); };
  const frame = (stamp) => {
    if (!playing) return;
    now += Number(speed.value) * Math.min(0.1, (stamp - last) / 1000); last = stamp;
    if (now >= end) { now = end; toggle(); }
    redraw(); requestAnimationFrame(frame);
  };
  const toggle = () => { playing = !playing; if (playing && now >= end) now = 0; play.textContent = playing ? "Pause" : "Play"; last = performance.now(); if (playing) requestAnimationFrame(frame); };
  play.onclick = toggle; slider.oninput = () => seek(Number(slider.value)); addEventListener("resize", redraw);
  addEventListener("keydown", (e) => { if (e.target.tagName === "INPUT" && e.key !== " ") return; if (e.key === " ") { e.preventDefault(); toggle(); } });
  redraw();
})();
