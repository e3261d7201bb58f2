// The map: what it shows, and what a pointer does with it.
import { drawMap } from 'map_drawing';
import { received, setTexts } from 'page_state';

const INITIAL_SCALE = 200; // [px/m]
const HANDLE_RADIUS_PX = 22; // within which a pointer grabs a handle
const DROPPED_POSE_MS = 500; // for which a dropped pose is drawn before that of the odometry
const ARROW_SCALE = 5; // [px] of a wheel's arrow for 1 rad/s

export default {
  props: { label: String },
  emits: ['drag', 'follow'],
  template: `
    <canvas ref="canvas" class="map" role="img" :aria-label="label" @pointerdown="grab"
      @pointermove="move" @pointerup="drop" @pointercancel="drop" @wheel.prevent="wheel"></canvas>`,
  mounted() {
    this.view = { x: 0, y: 0, scale: INITIAL_SCALE }; // [m], [m], [px/m]
    this.isFollowing = true;
    this.trajectories = { odom: [], ground_truth: [] };
    this.dragged = null;
    this.resizer = new ResizeObserver(() => this.requestDraw());
    this.resizer.observe(this.$refs.canvas);
  },
  unmounted() {
    this.resizer.disconnect();
  },
  methods: {
    setTexts,
    show(frame) {
      received.at = performance.now();
      for (const [name, added] of Object.entries(frame.trajectories)) {
        const kept = added.from ? this.trajectories[name].slice(0, added.from) : [];
        this.trajectories[name] = kept.concat(added.points);
      }
      this.frame = frame;
      if (this.dragged?.droppedAt && frame.frameTime > this.dragged.droppedAt + DROPPED_POSE_MS) {
        this.dragged.pose = null;
      }
      this.requestDraw();
    },
    drawDragged(pose, wheels) {
      this.dragged = { pose, wheels, droppedAt: pose ? this.frame?.frameTime ?? 1 : 0 };
      this.requestDraw();
    },
    drawMeasured() {
      this.dragged = null;
      this.requestDraw();
    },
    requestDraw() {
      if (this.request) return;
      this.request = requestAnimationFrame(() => {
        this.request = null;
        if (this.frame && this.$refs.canvas) this.draw();
      });
    },
    draw() {
      const { canvas } = this.$refs;
      const { frame } = this;
      this.size = { width: canvas.clientWidth, height: canvas.clientHeight };
      if (this.isFollowing && !this.drag) this.keepInView();
      drawMap(canvas, this);
      window.drawnFrame = { frameTime: frame.frameTime, stopCount: frame.stopCount };
      document.body.classList.toggle('silent', frame.isSilent);
      canvas.dataset.drawn = Number(canvas.dataset.drawn || 0) + 1;
    },
    zoom(factor) {
      this.view.scale = Math.min(2000, Math.max(5, this.view.scale * factor));
      this.requestDraw();
    },
    wheel(event) {
      this.zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15);
    },
    fit() {
      this.follow(true);
      this.view.scale = INITIAL_SCALE;
      this.requestDraw();
    },
    follow(isFollowing) {
      if (isFollowing !== this.isFollowing) this.$emit('follow', { isFollowing });
      this.isFollowing = isFollowing;
    },
    keepInView() {
      const [right, down] = this.toPixels(this.pose());
      const { width, height } = this.size;
      const margin = Math.min(width, height) / 4;
      const excess = (value, size) => (
        Math.min(0, value - margin) + Math.max(0, value + margin - size));
      this.view.x += excess(right, width) / this.view.scale;
      this.view.y -= excess(down, height) / this.view.scale;
    },
    // From [m] in the frame of the odometry to pixels, and back.
    toPixels([x, y]) {
      const { width, height } = this.size;
      return [width / 2 + (x - this.view.x) * this.view.scale,
        height / 2 - (y - this.view.y) * this.view.scale];
    },
    toMetres([right, down]) {
      const { width, height } = this.size;
      return [this.view.x + (right - width / 2) / this.view.scale,
        this.view.y - (down - height / 2) / this.view.scale];
    },
    pose() {
      return this.dragged?.pose ?? this.frame.odom;
    },
    wheels() {
      return this.dragged?.wheels ?? this.frame.wheels ?? [0, 0];
    },
    // The robot in pixels, at least as large as a finger.
    shape([x, y, theta]) {
      const half = Math.max(this.frame.wheelSeparation / 2 * this.view.scale, 26);
      const center = this.toPixels([x, y]);
      const at = (forward, left) => [
        center[0] + forward * Math.cos(theta) - left * Math.sin(theta),
        center[1] - forward * Math.sin(theta) - left * Math.cos(theta)];
      return { half, at, center, tip: at(2.2 * half, 0) };
    },
    handles() {
      const { at, half, center, tip } = this.shape(this.pose());
      const [left, right] = this.wheels();
      const wheel = (speed, side) => at(
        speed * ARROW_SCALE + (speed < 0 ? -14 : 14), side * half);
      return { left: wheel(left, 1.25), right: wheel(right, -1.25), tip, body: center };
    },
    grab(event) {
      if (event.button || !this.frame) return;
      const pointer = [event.offsetX, event.offsetY];
      const distances = Object.entries(this.handles()).map(([name, [x, y]]) => [
        Math.hypot(pointer[0] - x, pointer[1] - y), name]);
      const [distance, name] = distances.reduce((a, b) => (b[0] < a[0] ? b : a));
      this.drag = { name: distance < HANDLE_RADIUS_PX ? name : 'view', last: pointer };
      event.currentTarget.setPointerCapture(event.pointerId);
    },
    move(event) {
      if (!this.drag) return;
      const pointer = [event.offsetX, event.offsetY];
      const { name, last } = this.drag;
      this.drag.last = pointer;
      const [from, to] = [this.toMetres(last), this.toMetres(pointer)];
      if (name === 'view') {
        this.follow(false);
        this.view.x -= to[0] - from[0];
        this.view.y -= to[1] - from[1];
        this.requestDraw();
        return;
      }
      const [x, y, theta] = this.pose();
      const dragged = { pose: null, wheels: null, ...this.dragged, droppedAt: 0 };
      if (name === 'body') dragged.pose = [x + to[0] - from[0], y + to[1] - from[1], theta];
      else if (name === 'tip') dragged.pose = [x, y, Math.atan2(to[1] - y, to[0] - x)];
      else {
        const change = ((pointer[0] - last[0]) * Math.cos(theta)
          - (pointer[1] - last[1]) * Math.sin(theta)) / ARROW_SCALE;
        const [left, right] = this.wheels();
        dragged.wheels = name === 'left' ? [left + change, right] : [left, right + change];
      }
      this.dragged = dragged;
      this.$emit('drag', { pose: dragged.pose, wheels: dragged.wheels, isDropped: false });
      this.requestDraw();
    },
    drop() {
      const { drag, dragged } = this;
      this.drag = null;
      if (!drag || !dragged || drag.name === 'view') return;
      if (dragged.pose) dragged.droppedAt = this.frame.frameTime;
      this.$emit('drag', {
        ...window.drawnFrame,
        pose: ['body', 'tip'].includes(drag.name) ? dragged.pose : null,
        wheels: dragged.wheels, isDropped: true });
    },
  },
};
