// Joystick and keyboard of the driver, and the heartbeats with their state.
import { controls, limits, pad, received, releaseAll, stop } from 'page_state';

const HEARTBEAT_MS = 50;
const FRAME_TIMEOUT_MS = 1500; // a page that draws nothing gets a frame a second
const SUSPENSION_MS = 250; // between heartbeats: meanwhile the driver may have released a control
const KEYS = {
  KeyW: 'forward', ArrowUp: 'forward', KeyS: 'backward', ArrowDown: 'backward',
  KeyA: 'left', ArrowLeft: 'left', KeyD: 'right', ArrowRight: 'right',
};

const isVisible = () => document.visibilityState === 'visible';

export default {
  props: { label: String },
  emits: ['heartbeat', 'stop'],
  template: `
    <div ref="joystick" class="joystick" role="img" :aria-label="label" @pointerdown="grab"
      @pointermove="move" @pointerup="drop" @pointercancel="drop" @lostpointercapture="drop">
      <div ref="knob" class="knob"></div></div>`,
  mounted() {
    this.sequenceNumber = 0;
    this.sentAt = performance.now();
    this.listeners = new AbortController();
    const on = (target, type, act) => target.addEventListener(
      type, act, { signal: this.listeners.signal, capture: true });
    on(window, 'keydown', (event) => this.press(event));
    on(window, 'keyup', (event) => this.release(event));
    on(window, 'blur', (event) => {
      if (event.target === window) this.interrupt(); // not a button that loses the focus
    });
    on(window, 'pagehide', () => this.interrupt());
    on(document, 'visibilitychange', () => this.interrupt());
    on(window, 'contextmenu', (event) => {
      if (event.target.closest('.joystick')) event.preventDefault(); // after a long touch
      else this.interrupt();
    });
    pad.center = () => this.center();
    pad.sendHeartbeat = () => this.sendHeartbeat();
    this.timer = setInterval(() => this.sendHeartbeat(), HEARTBEAT_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    this.listeners.abort();
    releaseAll();
  },
  methods: {
    interrupt() {
      releaseAll();
      this.sendHeartbeat();
    },
    sendHeartbeat() {
      const now = performance.now();
      if (now - this.sentAt > SUSPENSION_MS || !isVisible() || !document.hasFocus()) releaseAll();
      this.sentAt = now;
      // A heartbeat that cannot go out now must not wait in a buffer; a dead link is a timeout.
      const isLost = !window.socket?.connected || !window.did_handshake
        || (isVisible() && now - received.at > FRAME_TIMEOUT_MS);
      document.body.classList.toggle('lost', isLost);
      if (isLost) {
        releaseAll();
        return;
      }
      this.$emit('heartbeat', {
        sequenceNumber: this.sequenceNumber++, frameTime: window.drawnFrame.frameTime,
        keys: [...controls.keys], joystick: controls.joystick, wheels: controls.wheels, limits,
        isInterrupted: controls.isInterrupted, isVisible: isVisible() });
      controls.isInterrupted = false;
    },
    press(event) {
      if (event.key === 'Escape') {
        stop(this);
        return;
      }
      // macOS sends no keyup of other keys while Meta is down.
      if (event.key === 'Meta') {
        this.interrupt();
        return;
      }
      const key = KEYS[event.code];
      const isInput = event.target.closest?.(event.code.startsWith('Arrow')
        ? 'input, textarea, select, [role=tab], [role=listbox], [role=combobox]'
        : 'input:not([type=range]), textarea, select');
      if (!key || isInput) return;
      if (event.ctrlKey || event.altKey || event.metaKey) {
        this.interrupt();
        return;
      }
      event.preventDefault();
      if (event.repeat) return; // held since before a stop: it has to be pressed anew
      controls.keys.add(key);
      this.sendHeartbeat();
    },
    release(event) {
      if (controls.keys.delete(KEYS[event.code])) this.sendHeartbeat();
    },
    grab(event) {
      if (event.button) return;
      event.currentTarget.setPointerCapture(event.pointerId);
      this.pointer = event.pointerId;
      // Measured once: if the page moves under the finger, the finger has not moved.
      this.box = this.$refs.joystick.getBoundingClientRect();
      this.move(event);
    },
    move(event) {
      if (event.pointerId !== this.pointer) return;
      const { box } = this;
      const reach = box.width / 2 - 32;
      let right = (event.clientX - box.left - box.width / 2) / reach;
      let forward = -(event.clientY - box.top - box.height / 2) / reach;
      const deflection = Math.max(1, Math.hypot(right, forward));
      [right, forward] = [right / deflection, forward / deflection];
      this.$refs.knob.style.transform = `translate(${right * reach}px, ${-forward * reach}px)`;
      const wasHeld = controls.joystick !== null;
      controls.joystick = [right, forward];
      if (!wasHeld) this.sendHeartbeat();
    },
    drop(event) {
      if (event.pointerId !== this.pointer) return;
      controls.joystick = null;
      this.center();
      this.sendHeartbeat();
    },
    center() {
      this.pointer = null;
      if (this.$refs.knob) this.$refs.knob.style.transform = '';
    },
  },
};
