// A slider of the browser's own. Its value is not bound: each update of the page would reset it.
import { limits } from 'page_state';

export default {
  props: { label: String, range: Array },
  template: `
    <div class="w-full"><div class="text-sm">{{ label }}: {{ value.toFixed(2) }}</div>
      <input ref="slider" type="range" class="limit" :aria-label="label" :min="range[0]"
        :max="range[1]" :step="range[2]" @input="set(Number($event.target.value))"></div>`,
  data() {
    return { value: this.range[3] };
  },
  mounted() {
    this.$refs.slider.value = this.value;
    this.set(this.value);
  },
  methods: {
    set(value) {
      this.value = value;
      limits[this.label] = value;
    },
  },
};
