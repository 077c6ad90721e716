// What part of the world an element shows, and how wheel, keys and dragging change it.

/** A middle in metres, y upwards, and pixels per metre; `draw` draws the element again. */
class Camera {
  /** `keys`: what further keys do, by name. */
  constructor(element, draw, keys = {}, [least, most] = [0.3, 60]) {
    Object.assign(this, { element, draw, least, most, x: 0, y: 0, scale: 1 });
    const actions = {
      "+": () => this.zoom(1.25),
      "=": () => this.zoom(1.25),
      "-": () => this.zoom(0.8),
      ...keys,
    };
    element.addEventListener("keydown", (event) => {
      if (!(event.key in actions)) return;
      event.preventDefault();
      actions[event.key]();
    });
    this.followPointer();
  }

  /** Show [left, bottom, right, top] in metres, with at most `most` pixels per metre. */
  fit([left, bottom, right, top], most = this.most) {
    const { width, height } = this.element.getBoundingClientRect();
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    this.scale = Math.min(width / (right - left), height / (top - bottom), most) || 1;
  }

  /** Nearer for factors above 1; what is under the pointer stays there. */
  zoom(factor, event = null) {
    const before = this.scale;
    this.scale = Math.min(Math.max(before * factor, this.least), this.most);
    if (event) {
      const { left, top, width, height } = this.element.getBoundingClientRect();
      const nearer = 1 / before - 1 / this.scale;
      this.x += (event.clientX - left - width / 2) * nearer;
      this.y -= (event.clientY - top - height / 2) * nearer;
    }
    this.draw();
  }

  /** Dragging moves what is seen; the wheel zooms once the element has the focus. */
  followPointer() {
    const { element } = this;
    let from = null,
      moved = 0;
    element.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY];
      moved = 0;
    });
    element.addEventListener("pointermove", (event) => {
      if (!event.buttons || !from) return;
      const across = event.clientX - from[0],
        down = event.clientY - from[1];
      from = [event.clientX, event.clientY];
      moved += Math.abs(across) + Math.abs(down);
      if (moved > 4) element.setPointerCapture(event.pointerId); // not of a click on what is drawn
      this.x -= across / this.scale;
      this.y += down / this.scale;
      this.draw();
    });
    // the end of a drag picks nothing
    element.addEventListener("click", (event) => moved > 4 && event.stopPropagation(), true);
    element.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && document.activeElement !== element) return; // the page scrolls
        event.preventDefault();
        this.zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15, event);
      },
      { passive: false },
    );
  }
}

/** [left, bottom, right, top] of places [x, y]; null of none. */
function boundsOf(places) {
  if (!places.length) return null;
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of places) {
    bounds[0] = Math.min(bounds[0], x);
    bounds[1] = Math.min(bounds[1], y);
    bounds[2] = Math.max(bounds[2], x);
    bounds[3] = Math.max(bounds[3], y);
  }
  return bounds;
}

/** Bounds with a margin in metres at each side. */
function widened([left, bottom, right, top], margin) {
  return [left - margin, bottom - margin, right + margin, top + margin];
}
