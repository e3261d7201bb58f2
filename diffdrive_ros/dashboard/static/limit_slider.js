// A slider of the browser's own. Its value is not bound: each update of the page would reset it.
export default {
  props: { label: String, range: Array },
  emits: ['limit'],
  template: `
    <input type="range" class="limit" :aria-label="label" :min="range[0]" :max="range[1]"
      :step="range[2]" @input="$emit('limit', { value: Number($event.target.value) })">`,
  mounted() {
    this.$el.value = this.range[3];
  },
};
