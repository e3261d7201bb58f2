// A text that changes often. It is not bound: Vue would render the whole page for each change.
import { connectText } from 'page_state';

export default {
  props: { label: String },
  template: '<div></div>',
  mounted() {
    connectText(this.label, this.$el.appendChild(document.createTextNode('')));
  },
};
