// A second finger causes no click, and a key or a screen reader no pointer event: each stops, once.
import { stop } from 'page_state';

export default {
  props: { label: String },
  emits: ['stop'],
  template: `
    <button type="button" class="stop" :aria-label="label" @pointerdown="press"
      @click="click">STOP</button>`,
  methods: {
    press(event) {
      if (event.button) return;
      this.isPressed = true;
      stop(this);
    },
    click(event) {
      if (event.detail === 0 || !this.isPressed) stop(this);
      this.isPressed = false;
    },
  },
};
