// The part of lil-gui that brax's viewer uses: folders of buttons, sliders and check boxes.
function element(tag, parent, properties) {
  return parent.appendChild(Object.assign(document.createElement(tag), properties));
}

class Control {
  constructor(parent, object, property, min, max, step) {
    Object.assign(this, {object, property});
    this.domElement = element('label', parent, {});
    const value = object[property];
    const type = {function: 'button', boolean: 'checkbox'}[typeof value] || (max === undefined ? 'number' : 'range');
    this.label = element('span', this.domElement, {textContent: property});
    this.input = element('input', this.domElement, {type});
    if (type === 'range' || type === 'number') {
      this.input.step = 'any';
      this.min(min).max(max).step(step);
    }
    const act = () => {
      if (type === 'button') return object[property]();
      object[property] = type === 'checkbox' ? this.input.checked : Number(this.input.value);
      if (this.changed) this.changed(object[property]);
    };
    this.input.addEventListener(type === 'button' ? 'click' : 'input', act);
    this.name(property).updateDisplay();
  }
  bound(attribute, value) {
    if (value !== undefined) this.input[attribute] = value;
    return this;
  }
  min(value) { return this.bound('min', value); }
  max(value) { return this.bound('max', value); }
  step(value) { return this.bound('step', value); }
  name(text) {
    this.label.textContent = this.input.type === 'button' ? '' : text;
    if (this.input.type === 'button') this.input.value = text;
    return this;
  }
  onChange(changed) {
    this.changed = changed;
    return this;
  }
  listen() {
    setInterval(() => this.updateDisplay(), 200);
    return this;
  }
  updateDisplay() {
    const value = this.object[this.property];
    if (this.input.type === 'checkbox') this.input.checked = value;
    else if (this.input.type !== 'button') this.input.value = Number(value.toFixed(3));
    return this;
  }
}

export class GUI {
  constructor(options, parent, title) {
    this.domElement = document.createElement('details');
    this.domElement.className = 'gui';
    element('summary', this.domElement, {textContent: title || 'Controls'});
    if (parent) parent.appendChild(this.domElement);
    this.open();
  }
  add(object, property, min, max, step) {
    return new Control(this.domElement, object, property, min, max, step);
  }
  addFolder(title) { return new GUI({}, this.domElement, title); }
  open() { this.domElement.open = true; }
  close() { this.domElement.open = false; }
}
