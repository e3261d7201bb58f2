// What has to happen in the browser: the heartbeat of whoever drives, and the map one can touch.
// kind 'pad' is the joystick, keys and heartbeat; 'hold' a button that drives while it is held;
// 'stop' the one that stops; 'limit' a slider; 'text' one that the map tells; 'map' the picture.
// All of a page share one hand, and one glance: what the newest picture told that was drawn.

const BEAT = 50; // [ms]
const SILENT = 1500; // [ms] without a picture: one that draws nothing gets one a second
const ASLEEP = 250; // [ms] between beats: this page was held up, and its hands may have let go
const KEYS = {
  KeyW: 'forward', ArrowUp: 'forward', KeyS: 'backward', ArrowDown: 'backward',
  KeyA: 'left', ArrowLeft: 'left', KeyD: 'right', ArrowRight: 'right',
};
// lost: it held something that was taken from it, which the driver has to be told.
const hand = { keys: new Set(), stick: null, wheels: false, lost: false, release: [] };
// When the server sent it, on its clock, and how often STOP had been pressed then; clicks carry it.
window.glance = { sight: 0, stops: 0 };
let heardAt = performance.now(); // when the newest picture came

function letGo() {
  hand.lost ||= hand.keys.size > 0 || hand.stick !== null || hand.wheels;
  hand.keys.clear();
  hand.stick = null;
  hand.wheels = false;
  hand.release.forEach((each) => each());
}

function halt(view) {
  letGo();
  hand.lost = false;
  view.$emit('halt');
}

const isWatched = () => document.visibilityState === 'visible' && document.hasFocus();

const pad = {
  start() {
    this.number = 0;
    this.beatAt = performance.now();
    this.ends = new AbortController();
    const on = (target, type, act) => target.addEventListener(
      type, act, { signal: this.ends.signal, capture: true });
    on(window, 'keydown', (event) => this.down(event));
    on(window, 'keyup', (event) => this.up(event));
    on(window, 'blur', (event) => {
      if (event.target === window) this.rest(); // not a button that the focus leaves
    });
    on(window, 'pagehide', () => this.rest());
    on(document, 'visibilitychange', () => this.rest());
    on(window, 'contextmenu', (event) => {
      if (event.target.closest('.stick')) event.preventDefault(); // a long touch is no menu
      else this.rest();
    });
    hand.release.push(() => this.center());
    hand.beat = () => this.beat();
    this.timer = setInterval(() => this.beat(), BEAT);
  },
  end() {
    clearInterval(this.timer);
    this.ends.abort();
    letGo();
  },
  rest() {
    letGo();
    this.beat();
  },
  beat() {
    const now = performance.now();
    if (now - this.beatAt > ASLEEP || !isWatched()) letGo();
    this.beatAt = now;
    // What cannot go out now must not wait in a buffer until it can; a dead link tells by silence.
    const isLost = !window.socket?.connected || !window.did_handshake
      || (document.visibilityState === 'visible' && now - heardAt > SILENT);
    document.body.classList.toggle('lost', isLost);
    if (isLost) return letGo();
    this.$emit('beat', {
      number: this.number++, sight: window.glance.sight, keys: [...hand.keys], stick: hand.stick,
      wheels: hand.wheels, lost: hand.lost, visible: document.visibilityState === 'visible' });
    hand.lost = false;
  },
  down(event) {
    if (event.key === 'Escape') return halt(this);
    // macOS tells no release of a key while this one is down.
    if (event.key === 'Meta') return this.rest();
    const key = KEYS[event.code];
    const busy = event.target.closest?.(event.code.startsWith('Arrow')
      ? 'input, textarea, select, [role=tab], [role=listbox], [role=combobox]'
      : 'input:not([type=range]), textarea, select');
    if (!key || busy) return;
    if (event.ctrlKey || event.altKey || event.metaKey) return this.rest();
    event.preventDefault();
    if (event.repeat) return; // held since before a stop: it has to be pressed anew
    hand.keys.add(key);
    this.beat();
  },
  up(event) {
    if (!hand.keys.delete(KEYS[event.code])) return;
    this.beat();
  },
  grab(event) {
    if (event.button) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    this.pointer = event.pointerId;
    this.box = this.$refs.stick.getBoundingClientRect(); // should it move, the finger did not
    this.move(event);
  },
  move(event) {
    if (event.pointerId !== this.pointer) return;
    const { box } = this;
    const reach = box.width / 2 - 32;
    let right = (event.clientX - box.left - box.width / 2) / reach;
    let ahead = -(event.clientY - box.top - box.height / 2) / reach;
    const way = Math.max(1, Math.hypot(right, ahead));
    [right, ahead] = [right / way, ahead / way];
    this.$refs.knob.style.transform = `translate(${right * reach}px, ${-ahead * reach}px)`;
    const was = hand.stick;
    hand.stick = [right, ahead];
    if (!was) this.beat();
  },
  drop(event) {
    if (event.pointerId !== this.pointer) return;
    hand.stick = null;
    this.center();
    this.beat();
  },
  center() {
    this.pointer = null;
    if (this.$refs.knob) this.$refs.knob.style.transform = '';
  },
};

const hold = {
  press(event) {
    if (event.repeat || event.button) return;
    event.preventDefault();
    event.currentTarget.focus();
    if (event.pointerId !== undefined) event.currentTarget.setPointerCapture(event.pointerId);
    hand.wheels = true;
    hand.beat?.();
  },
  lift() {
    if (!hand.wheels) return;
    hand.wheels = false;
    hand.beat?.();
  },
};

// A second finger makes no click, and a key or a screen reader no press: each of them stops, once.
const stop = {
  press(event) {
    if (event.button) return;
    this.isPressed = true;
    halt(this);
  },
  click(event) {
    if (event.detail === 0 || !this.isPressed) halt(this);
    this.isPressed = false;
  },
};

const limit = {
  start() {
    this.$el.value = this.range[3]; // not bound: every drawing of the page would set it again
  },
};

// Not bound: the whole page would be drawn again for each, which holds up who shares the processor.
const texts = {};
const words = {}; // of each text: those of a panel are made anew when it is opened
const text = {
  start() {
    texts[this.label] = this.$el.appendChild(document.createTextNode(words[this.label] ?? ''));
  },
};

const SCALE = 200; // [px/m] at first
const HANDLE = 22; // [px] around a handle that still touches it
const SPEED = 5; // [px] of a wheel's arrow for 1 rad/s
const chart = {
  start() {
    this.view = { x: 0, y: 0, scale: SCALE }; // [m], [m], [px/m]
    this.follows = true;
    this.tracks = { odom: [], truth: [] };
    this.touched = null;
    this.resizer = new ResizeObserver(() => this.ask());
    this.resizer.observe(this.$refs.canvas);
  },
  end() {
    this.resizer.disconnect();
  },
  show(frame) {
    heardAt = performance.now();
    for (const [name, news] of Object.entries(frame.tracks)) {
      const kept = news.from ? this.tracks[name].slice(0, news.from) : [];
      this.tracks[name] = kept.concat(news.points);
    }
    this.frame = frame;
    if (this.touched?.sent && frame.tick > this.touched.sent + 500) this.touched.pose = null;
    this.ask();
  },
  tell(news) {
    Object.assign(words, news);
    for (const name of Object.keys(news)) {
      if (texts[name] && texts[name].data !== words[name]) texts[name].data = words[name];
    }
  },
  forget() {
    this.touched = null;
    this.ask();
  },
  ask() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = null;
      if (this.frame && this.$refs.canvas) this.draw();
    });
  },
  zoom(factor) {
    this.view.scale = Math.min(2000, Math.max(5, this.view.scale * factor));
    this.ask();
  },
  fit() {
    this.follow(true);
    this.view.scale = SCALE;
    this.ask();
  },
  follow(follows) {
    if (follows !== this.follows) this.$emit('follow', { follows });
    this.follows = follows;
  },
  wheel(event) {
    this.zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15);
  },
  // World to pixels and back.
  px([x, y]) {
    const { width, height } = this.size;
    return [width / 2 + (x - this.view.x) * this.view.scale,
      height / 2 - (y - this.view.y) * this.view.scale];
  },
  world([right, down]) {
    const { width, height } = this.size;
    return [this.view.x + (right - width / 2) / this.view.scale,
      this.view.y - (down - height / 2) / this.view.scale];
  },
  pose() {
    return this.touched?.pose ?? this.frame.odom;
  },
  wheels() {
    return this.touched?.wheels ?? this.frame.wheels ?? [0, 0];
  },
  // The robot as it is drawn: never smaller than a finger.
  shape([x, y, theta]) {
    const half = Math.max(this.frame.geometry[0] / 2 * this.view.scale, 26);
    const [cx, cy] = this.px([x, y]);
    const at = (ahead, left) => [
      cx + ahead * Math.cos(theta) - left * Math.sin(theta),
      cy - ahead * Math.sin(theta) - left * Math.cos(theta)];
    return { half, at, center: [cx, cy], tip: at(2.2 * half, 0) };
  },
  handles() {
    const { at, half, center, tip } = this.shape(this.pose());
    const [left, right] = this.wheels();
    const wheel = (speed, side) => at(speed * SPEED + (speed < 0 ? -14 : 14), side * half);
    return { left: wheel(left, 1.25), right: wheel(right, -1.25), tip, body: center };
  },
  grab(event) {
    if (event.button || !this.frame) return;
    const point = [event.offsetX, event.offsetY];
    const away = Object.entries(this.handles()).map(([name, [x, y]]) => [
      Math.hypot(point[0] - x, point[1] - y), name]);
    const [distance, name] = away.reduce((a, b) => (b[0] < a[0] ? b : a));
    this.drag = { name: distance < HANDLE ? name : 'view', last: point };
    event.currentTarget.setPointerCapture(event.pointerId);
  },
  move(event) {
    if (!this.drag) return;
    const point = [event.offsetX, event.offsetY];
    const { name, last } = this.drag;
    this.drag.last = point;
    const [from, to] = [this.world(last), this.world(point)];
    if (name === 'view') {
      this.follow(false);
      this.view.x -= to[0] - from[0];
      this.view.y -= to[1] - from[1];
      return this.ask();
    }
    const [x, y, theta] = this.pose();
    this.touched = { pose: null, wheels: null, ...this.touched, sent: 0 };
    if (name === 'body') this.touched.pose = [x + to[0] - from[0], y + to[1] - from[1], theta];
    else if (name === 'tip') this.touched.pose = [x, y, Math.atan2(to[1] - y, to[0] - x)];
    else {
      const along = ((point[0] - last[0]) * Math.cos(theta)
        - (point[1] - last[1]) * Math.sin(theta)) / SPEED;
      const [left, right] = this.wheels();
      this.touched.wheels = name === 'left' ? [left + along, right] : [left, right + along];
    }
    this.$emit('touch', { pose: this.touched.pose, wheels: this.touched.wheels, done: false });
    this.ask();
  },
  drop() {
    const drag = this.drag;
    this.drag = null;
    if (!drag || !this.touched || drag.name === 'view') return;
    if (this.touched.pose) this.touched.sent = this.frame.tick;
    this.$emit('touch', {
      ...window.glance,
      pose: ['body', 'tip'].includes(drag.name) ? this.touched.pose : null,
      wheels: this.touched.wheels, done: true });
  },
  touch(pose, wheels) {
    this.touched = { pose, wheels, sent: pose ? this.frame?.tick ?? 1 : 0 };
    this.ask();
  },
  draw() {
    const canvas = this.$refs.canvas;
    const ratio = window.devicePixelRatio || 1;
    this.size = { width: canvas.clientWidth, height: canvas.clientHeight };
    if (canvas.width !== Math.round(this.size.width * ratio)
      || canvas.height !== Math.round(this.size.height * ratio)) {
      canvas.width = Math.round(this.size.width * ratio);
      canvas.height = Math.round(this.size.height * ratio);
    }
    const pen = canvas.getContext('2d', { alpha: false }); // what lets through is costly to show
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(canvas);
    pen.fillStyle = style.getPropertyValue('--panel');
    pen.fillRect(0, 0, this.size.width, this.size.height);
    const color = (name) => style.getPropertyValue(`--map-${name}`);
    if (this.follows && !this.drag) this.keepInView();
    this.drawGrid(pen, color('grid'), color('text'));
    this.drawTrack(pen, this.tracks.truth, this.frame.truth, color('truth'), [6, 4]);
    this.drawTrack(pen, this.tracks.odom, this.frame.odom, color('odom'), []);
    this.drawEllipse(pen, color('ellipse'));
    if (this.frame.truth) this.drawRobot(pen, this.frame.truth, color('truth'), false);
    this.drawRobot(pen, this.pose(), color('odom'), true, color);
    window.glance = { sight: this.frame.tick, stops: this.frame.stops };
    document.body.classList.toggle('silent', this.frame.silent);
    canvas.dataset.drawn = Number(canvas.dataset.drawn || 0) + 1;
  },
  keepInView() {
    const [right, down] = this.px(this.pose());
    const { width, height } = this.size;
    const margin = Math.min(width, height) / 4;
    const over = (value, most) => Math.min(0, value - margin) + Math.max(0, value + margin - most);
    this.view.x += over(right, width) / this.view.scale;
    this.view.y -= over(down, height) / this.view.scale;
  },
  drawGrid(pen, lineColor, labelColor) {
    const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10].find(
      (each) => each * this.view.scale > 56) ?? 20;
    const [[left, top], [right, bottom]] = [
      this.world([0, 0]), this.world([this.size.width, this.size.height])];
    pen.lineWidth = 1;
    pen.strokeStyle = lineColor;
    pen.fillStyle = labelColor;
    pen.font = '12px sans-serif';
    for (let i = Math.ceil(left / step); i * step < right; i += 1) {
      const [x] = this.px([i * step, 0]);
      this.path(pen, [[x, 0], [x, this.size.height]]);
      pen.fillText(`${Number((i * step).toFixed(2))}${i ? '' : ' m'}`, x + 3, this.size.height - 4);
    }
    for (let i = Math.ceil(bottom / step); i * step < top; i += 1) {
      const [, y] = this.px([0, i * step]);
      this.path(pen, [[0, y], [this.size.width, y]]);
      pen.fillText(`${Number((i * step).toFixed(2))}${i ? '' : ' m'}`, 4, y - 3);
    }
  },
  path(pen, points) {
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
  },
  drawTrack(pen, points, end, color, dash) {
    if (!points.length) return;
    pen.strokeStyle = color;
    pen.lineWidth = 2;
    pen.setLineDash(dash);
    pen.beginPath();
    for (const [x, y, isStart] of points) {
      const [right, down] = this.px([x, y]);
      if (isStart) pen.moveTo(right, down);
      else pen.lineTo(right, down);
    }
    if (end) pen.lineTo(...this.px(end));
    pen.stroke();
    pen.setLineDash([]);
  },
  drawEllipse(pen, color) {
    if (!this.frame.ellipse) return;
    const [x, y] = this.px(this.frame.odom);
    const [long, short, angle] = this.frame.ellipse;
    pen.beginPath();
    pen.ellipse(x, y, long * this.view.scale, short * this.view.scale, -angle, 0, 2 * Math.PI);
    pen.fillStyle = color;
    pen.fill();
  },
  drawRobot(pen, pose, color, isOurs, colors) {
    const { half, at, tip } = this.shape(pose);
    pen.strokeStyle = color;
    pen.lineWidth = isOurs ? 3 : 2;
    pen.setLineDash(isOurs ? [] : [6, 4]);
    const corners = [[1.3, 0.8], [1.3, -0.8], [-0.9, -0.8], [-0.9, 0.8], [1.3, 0.8]];
    this.path(pen, corners.map(([ahead, left]) => at(ahead * half, left * half)));
    pen.setLineDash([]);
    if (!isOurs) return;
    for (const side of [1, -1]) {
      pen.lineWidth = 7;
      this.path(pen, [at(-0.45 * half, side * half), at(0.45 * half, side * half)]);
    }
    pen.lineWidth = 3;
    this.path(pen, [at(0, 0), tip]);
    const { left, right, body } = this.handles();
    const dot = ([x, y], radius, fill) => {
      pen.beginPath();
      pen.arc(x, y, radius, 0, 2 * Math.PI);
      pen.fillStyle = fill;
      pen.fill();
    };
    dot(tip, 8, color);
    dot(body, 8, color);
    pen.strokeStyle = colors('wheel');
    pen.lineWidth = 3;
    this.path(pen, [at(0, 1.25 * half), left]);
    this.path(pen, [at(0, -1.25 * half), right]);
    dot(left, 7, colors('wheel'));
    dot(right, 7, colors('wheel'));
  },
};

export default {
  props: { kind: String, label: String, range: Array },
  emits: ['beat', 'halt', 'touch', 'limit', 'follow'],
  template: `
    <div v-if="kind === 'pad'" ref="stick" class="stick" role="img" :aria-label="label"
      @pointerdown="grab" @pointermove="move" @pointerup="drop" @pointercancel="drop"
      @lostpointercapture="drop"><div ref="knob" class="knob"></div></div>
    <button v-else-if="kind === 'hold'" type="button" class="hold"
      @pointerdown="press" @pointerup="lift" @pointercancel="lift" @lostpointercapture="lift"
      @keydown.space="press" @keydown.enter="press" @keyup.space.prevent="lift"
      @keyup.enter="lift" @blur="lift">{{ label }}</button>
    <button v-else-if="kind === 'stop'" type="button" class="stop" :aria-label="label"
      @pointerdown="press" @click="click">STOP</button>
    <input v-else-if="kind === 'limit'" type="range" class="limit" :aria-label="label"
      :min="range[0]" :max="range[1]" :step="range[2]"
      @input="$emit('limit', { value: Number($event.target.value) })">
    <div v-else-if="kind === 'text'"></div>
    <canvas v-else ref="canvas" class="map" role="img" :aria-label="label" @pointerdown="grab"
      @pointermove="move" @pointerup="drop" @pointercancel="drop" @wheel.prevent="wheel"></canvas>`,
  created() {
    const behaviour = { pad, hold, stop, limit, text, map: chart }[this.kind];
    for (const [name, act] of Object.entries(behaviour)) this[name] = act.bind(this);
  },
  mounted() {
    this.start?.();
  },
  unmounted() {
    this.end?.();
  },
};
