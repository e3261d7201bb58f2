// What the elements of a page share: held controls, the newest frame, and texts.

// isInterrupted: the page released a control that the driver may still hold.
export const controls = { keys: new Set(), joystick: null, wheels: false, isInterrupted: false };

// The speed limits [m/s, rad/s], by the labels of their sliders.
export const limits = {};

// The teleop pad sets these functions.
export const pad = { center() {}, sendHeartbeat() {} };

// Of the newest frame that was drawn: its time on the server's clock [ms], and how often STOP had
// been pressed. Every click sends it, so that the server computes its latency.
window.drawnFrame = { frameTime: 0, stopCount: 0 };
export const received = { at: performance.now() }; // when the newest frame arrived

// The dead-man switch: the controls count again when the driver has released and pressed them.
export function releaseAll() {
  controls.isInterrupted ||= controls.keys.size > 0 || controls.joystick !== null
    || controls.wheels;
  controls.keys.clear();
  controls.joystick = null;
  controls.wheels = false;
  pad.center();
}

export function stop(element) {
  releaseAll();
  controls.isInterrupted = false;
  element.$emit('stop');
}

// The texts that change often, by their labels; a panel that is opened again has new nodes.
const texts = {};
const nodes = {};

export function connectText(label, node) {
  nodes[label] = node;
  node.data = texts[label] ?? '';
}

export function setTexts(changes) {
  Object.assign(texts, changes);
  for (const label of Object.keys(changes)) {
    if (nodes[label] && nodes[label].data !== texts[label]) nodes[label].data = texts[label];
  }
}
