// A button that drives the chosen wheel speeds while it is held.
import { controls, pad } from 'page_state';

export default {
  props: { label: String },
  template: `
    <button type="button" class="hold" @pointerdown="press" @pointerup="release"
      @pointercancel="release" @lostpointercapture="release" @keydown.space="press"
      @keydown.enter="press" @keyup.space.prevent="release" @keyup.enter="release"
      @blur="release">{{ label }}</button>`,
  methods: {
    press(event) {
      if (event.repeat || event.button) return;
      event.preventDefault();
      event.currentTarget.focus();
      if (event.pointerId !== undefined) event.currentTarget.setPointerCapture(event.pointerId);
      controls.wheels = true;
      pad.sendHeartbeat();
    },
    release() {
      if (!controls.wheels) return;
      controls.wheels = false;
      pad.sendHeartbeat();
    },
  },
};
