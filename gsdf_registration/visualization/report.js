// SPDX-License-Identifier: Apache-2.0
// The 3-D view of the report: WebGL, no library, no request. Millimetres.
(() => {
  const canvas = document.getElementById('view');
  const data = JSON.parse(document.getElementById('scene').textContent);
  const gl = canvas.getContext('webgl', {preserveDrawingBuffer: true, antialias: true});
  if (!gl || !gl.getExtension('OES_element_index_uint')) {
    document.getElementById('no-webgl').hidden = false;
    return;
  }
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const floats = text => new Float32Array(bytes(text).buffer);

  // geometry
  const buffer = (values, target = gl.ARRAY_BUFFER) => {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, values, gl.STATIC_DRAW);
    return made;
  };
  const cloud = (points, colours) =>
    ({at: buffer(points), colour: buffer(colours), count: points.length / 3, points});
  const normalsOf = (v, f) => {
    const n = new Float32Array(v.length);
    for (let t = 0; t < f.length; t += 3) {
      const [a, b, c] = [3 * f[t], 3 * f[t + 1], 3 * f[t + 2]];
      const u = [0, 1, 2].map(k => v[b + k] - v[a + k]), w = [0, 1, 2].map(k => v[c + k] - v[a + k]);
      const x = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
      for (const i of [a, b, c]) for (let k = 0; k < 3; k++) n[i + k] += x[k];
    }
    return n;
  };
  let bone = null, border = null;
  if (data.bone) {
    const v = floats(data.bone.vertices), f = new Uint32Array(bytes(data.bone.faces).buffer);
    const b = floats(data.bone.border);
    bone = cloud(v, bytes(data.bone.colours));
    bone.normal = buffer(f.length ? normalsOf(v, f) : new Float32Array(v.length));
    bone.faces = buffer(f, gl.ELEMENT_ARRAY_BUFFER);
    bone.corners = f.length;
    border = cloud(b, new Uint8Array(b.length).fill(27));
  }
  const sets = data.sets.map(each => cloud(floats(each.points), bytes(each.colours)));
  const extent = points => {
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (let i = 0; i < points.length; i++) {
      low[i % 3] = Math.min(low[i % 3], points[i]);
      high[i % 3] = Math.max(high[i % 3], points[i]);
    }
    return points.length ? [low, high] : [[-1, -1, -1], [1, 1, 1]];
  };
  const [low, high] = extent(bone ? bone.points : sets[0].points);
  const middle = low.map((value, k) => (value + high[k]) / 2);
  let size = 1;       // distance of the farthest place from the middle
  const all = bone ? bone.points : sets[0].points;
  for (let i = 0; i < all.length; i += 3) {
    size = Math.max(size, Math.hypot(...middle.map((value, k) => all[i + k] - value)));
  }

  // program: light from the viewer; round points
  const shader = (type, source) => {
    const made = gl.createShader(type);
    gl.shaderSource(made, source);
    gl.compileShader(made);
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 at, normal, colour; uniform mat3 turn; uniform vec3 centre; uniform vec4 frame;
    uniform float lit, dot, lift; varying vec3 shade;
    void main() {
      vec3 p = turn * (at - centre);
      vec3 n = turn * normal;
      float l = length(n) > 0.0 ? abs(n.z) / length(n) : 1.0;
      shade = colour * mix(1.0, 0.35 + 0.65 * l, lit);
      gl_Position = vec4((p.xy + frame.zw) * frame.xy, -p.z / ${(4 * size).toFixed(1)} - lift, 1.0);
      gl_PointSize = dot;
    }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float; varying vec3 shade; uniform float alpha, round;
    void main() {
      float r = length(gl_PointCoord - 0.5) * round;
      if (r > 0.5) discard;
      gl_FragColor = vec4(shade * (1.0 - 0.5 * r * r) * alpha, alpha);
    }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = name => gl.getAttribLocation(program, name);
  const uniform = name => gl.getUniformLocation(program, name);
  const u = Object.fromEntries(['turn', 'centre', 'frame', 'lit', 'dot', 'lift', 'alpha', 'round']
    .map(name => [name, uniform(name)]));
  const bind = mesh => {
    const attribute = (name, source, type, normalized) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, source);
      gl.enableVertexAttribArray(at(name));
      gl.vertexAttribPointer(at(name), 3, type, normalized, 0, 0);
    };
    attribute('at', mesh.at, gl.FLOAT, false);
    attribute('colour', mesh.colour, gl.UNSIGNED_BYTE, true);
    if (mesh.normal) attribute('normal', mesh.normal, gl.FLOAT, false);
    else { gl.disableVertexAttribArray(at('normal')); gl.vertexAttrib3f(at('normal'), 0, 0, 0); }
  };
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

  // camera: rows of `turn` are right, up, towards the viewer
  const cross = (a, b) =>
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = a => a.map(value => value / (Math.hypot(...a) || 1));
  const dotOf = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const from = direction => {
    const back = unit(direction), upright = Math.abs(back[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0];
    const right = unit(cross(upright, back));
    return [right, cross(back, right), back];
  };
  let turn, centre, radius, shown = 0, scale = 1, ratio = 1;
  const look = (direction, middleOf, radiusOf) => {
    [turn, centre, radius] = [from(direction), middleOf.slice(), radiusOf];
    draw();
  };
  const ends = {};
  if (data.letters) {
    [1, -1].forEach((sign, k) => [...data.letters[k]].forEach((letter, axis) => {
      ends[letter] = [0, 1, 2].map(i => i === axis ? sign : 0);
    }));
  }
  const home = () => data.focus ? look(data.focus.from, middle, size) : look([0, -1, 0], middle, size);

  // labels over the canvas
  const overlay = document.getElementById('labels');
  const label = (text, kind, place) => {
    const made = document.createElement('span');
    made.textContent = text;
    made.className = kind;
    overlay.append(made);
    return {made, place};
  };
  const labels = data.labels.map(each => label(each.text, each.kind, each.at));
  for (const [letter, direction] of Object.entries(ends)) {
    labels.push(label(letter, 'letter', middle.map(
      (value, k) => value + direction[k] * ((high[k] - low[k]) / 2 + 0.08 * size))));
  }

  function draw() {
    const w = canvas.clientWidth, h = canvas.clientHeight;
    ratio = Math.min(window.devicePixelRatio || 1, 2);
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
    scale = Math.min(w, h) / (2.1 * radius);       // pixels of the page per mm
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix3fv(u.turn, false, [0, 1, 2].flatMap(k => turn.map(row => row[k])));
    gl.uniform3fv(u.centre, centre);
    gl.uniform4f(u.frame, 2 * scale / w, 2 * scale / h, 0, 0);
    const set = (lit, size, lift, alpha, round) => {
      [[u.lit, lit], [u.dot, size * ratio], [u.lift, lift], [u.alpha, alpha], [u.round, round]]
        .forEach(([name, value]) => gl.uniform1f(name, value));
    };
    gl.depthFunc(gl.LEQUAL);
    gl.depthMask(true);
    if (bone && document.getElementById('show-bone').checked) {
      bind(bone);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, bone.faces);
      set(1, 3, 0, 1, 0);
      if (bone.corners) gl.drawElements(gl.TRIANGLES, bone.corners, gl.UNSIGNED_INT, 0);
      else gl.drawArrays(gl.POINTS, 0, bone.count);
      bind(border);
      set(0, 3, 0.004, 1, 0);
      gl.drawArrays(gl.LINES, 0, border.count);
      set(0, 2.5, 0.004, 1, 1);
      gl.drawArrays(gl.POINTS, 0, border.count);
    }
    const dots = sets[shown], large = Math.max(4, Math.min(12, 1.6 * scale));
    bind(dots);
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);       // behind or inside the bone: smaller and translucent
    set(0, 0.7 * large, 0.006, 0.45, 1);
    gl.drawArrays(gl.POINTS, 0, dots.count);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    set(0, large, 0.006, 1, 1);
    gl.drawArrays(gl.POINTS, 0, dots.count);
    for (const {made, place} of labels) {
      const p = turn.map(row => dotOf(row, place.map((value, k) => value - centre[k])));
      const [x, y] = [w / 2 + scale * p[0], h / 2 - scale * p[1]];
      const above = made.className === 'letter' ? '-50%' : 'calc(-100% - 8px)';
      made.style.transform = `translate(${x}px, ${y}px) translate(-50%, ${above})`;
      made.hidden = x < 0 || x > w || y < 0 || y > h;
      made.style.opacity = p[2] < 0 && made.className === 'letter' ? 0.35 : 1;
    }
    const bar = document.getElementById('bar');
    const length = [1, 2, 5, 10, 20, 50, 100, 200].find(mm => mm * scale >= 50) || 500;
    bar.style.width = `${length * scale}px`;
    bar.textContent = `${length} mm`;
  }

  // buttons
  const bar = document.getElementById('buttons');
  const button = (text, title, press) => {
    const made = document.createElement('button');
    Object.assign(made, {textContent: text, title, type: 'button', onclick: press});
    bar.append(made);
    return made;
  };
  const names = {A: 'from anterior', P: 'from posterior', L: 'from left', R: 'from right',
    S: 'from superior', I: 'from inferior'};
  for (const letter of 'APLRSI') {
    if (ends[letter]) button(letter, names[letter], () => look(ends[letter], middle, size));
  }
  if (data.focus) {
    button('touched area', 'what was touched',
      () => look(data.focus.from, data.focus.centre, data.focus.radius));
  }
  button('whole', 'all of it, from the side that was touched', home);
  if (sets.length > 1) {
    const choices = data.sets.map((each, k) => button(each.name, 'points at this pose', () => {
      shown = k;
      choices.forEach((one, n) => one.setAttribute('aria-pressed', n === k));
      draw();
    }));
    choices[0].setAttribute('aria-pressed', true);
  }
  document.getElementById('show-bone').onchange = draw;

  // one finger or button turns, two fingers or shift move, wheel or pinch scales
  const held = new Map();
  const turnBy = (dx, dy) => {
    const [right, up, back] = turn, mix = (a, s, b, t) => a.map((value, k) => s * value + t * b[k]);
    const [c, s, e, f] = [Math.cos(dx), Math.sin(dx), Math.cos(dy), Math.sin(dy)];
    const across = mix(right, c, back, s), near = mix(back, c, right, -s);
    turn = [across, mix(up, e, near, -f), mix(near, e, up, f)].map(unit);
  };
  const moveBy = (dx, dy) => {
    centre = centre.map((value, k) => value - (dx * turn[0][k] - dy * turn[1][k]) / scale);
  };
  const zoom = factor => { radius = Math.min(4 * size, Math.max(0.02 * size, radius * factor)); };
  canvas.onpointerdown = event => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.clientX, event.clientY]);
  };
  canvas.onpointerup = canvas.onpointercancel = event => held.delete(event.pointerId);
  canvas.onpointermove = event => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    const span = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    const apart = held.size === 2 ? span() : 0;
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (held.size === 2) { moveBy(dx / 2, dy / 2); zoom(apart / Math.max(span(), 1)); }
    else if (event.shiftKey || event.buttons === 2) moveBy(dx, dy);
    else turnBy(0.01 * dx, 0.01 * dy);
    draw();
  };
  canvas.oncontextmenu = event => event.preventDefault();
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
    draw();
  }, {passive: false});
  new ResizeObserver(draw).observe(canvas);
  window.addEventListener('beforeprint', draw);
  home();
})();
