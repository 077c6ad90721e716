// The replay of an opened run: time, keys, mouse.

const SPEEDS = ["0.25", "0.5", "1", "2", "4"];
/** Choices that hold for the next run, too. */
const playing = {
  shown: {
    map: true,
    lights: true,
    driven: true,
    heat: true,
    candidates: true,
    reactions: true,
    scores: true,
    unseen: true,
  },
  speed: "1",
  follow: false,
};

/** The replay of a scene. Its elements are `stage` and `charts.element`; draw it once they are there. */
class Player {
  constructor(scene) {
    this.scene = scene;
    this.step = beginOf(scene);
    this.running = false;
    this.drawnAt = 0; // ms
    this.fitted = false; // when it is drawn
    this.candidate = null; // number of that whose reactions are shown; null: the chosen one
    this.plan = undefined; // what the panel shows
    this.charts = chartsOf(scene, (step) => this.seek(step));
    this.panel = make("section", { "aria-label": "Plan" });
    this.readout = make("p", { class: "readout" });
    this.canvas = this.makeCanvas();
    this.slider = make("input", {
      type: "range",
      min: 0,
      max: scene.steps - 1,
      step: 1,
      value: this.step,
      "aria-label": "step",
      oninput: (event) => this.seek(Number(event.target.value)),
    });
    this.button = make("button", { type: "button", onclick: () => this.toggle() }, "Play");
    this.stage = make(
      "div",
      { class: "stage" },
      make("div", {}, this.canvas, this.controls(), this.readout),
      make(
        "div",
        { class: "side" },
        layers(scene, () => this.draw()),
        this.panel,
      ),
    );
  }

  draw() {
    const { scene, step, canvas } = this;
    if (!this.fitted) this.camera.fit(drivenBounds(scene), 14);
    this.fitted = true;
    const pose = playing.follow ? poseAt(scene.av, step) : null;
    if (pose) Object.assign(this.camera, { x: pose.x, y: pose.y });
    const plan = planAt(scene, step);
    if (plan !== this.plan) this.showPlan(plan);
    drawMoment(canvas, scene, this.camera, step, playing.shown, this.candidate);
    this.slider.value = Math.round(step);
    const seconds = ((step - scene.now) * scene.dt).toFixed(1);
    this.slider.setAttribute("aria-valuetext", `${seconds} s`);
    this.readout.textContent = momentText(scene, step);
    this.charts.move(step);
  }

  showPlan(plan) {
    this.plan = plan;
    this.candidate = null;
    const pick = (number) => {
      this.candidate = number;
      this.draw();
    };
    this.panel.replaceChildren(...planElements(this.scene, plan, pick));
  }

  seek(step) {
    this.step = Math.min(Math.max(step, 0), this.scene.steps - 1);
    this.draw();
  }

  toggle() {
    this.running = !this.running;
    this.button.textContent = this.running ? "Pause" : "Play";
    if (!this.running) return;
    if (this.step >= this.scene.steps - 1) this.step = beginOf(this.scene);
    this.drawnAt = performance.now();
    requestAnimationFrame((now) => this.advance(now));
  }

  advance(now) {
    if (!this.running || !this.canvas.isConnected) return;
    const seconds = ((now - this.drawnAt) / 1000) * Number(playing.speed);
    const step = this.step + seconds / this.scene.dt;
    this.drawnAt = now;
    this.seek(step);
    if (step >= this.scene.steps - 1) this.toggle();
    else requestAnimationFrame((later) => this.advance(later));
  }

  stop() {
    this.running = false;
  }

  fit() {
    this.fitted = false;
    this.draw();
  }

  makeCanvas() {
    const canvas = make("canvas", {
      tabindex: "0",
      role: "img",
      "aria-label": "Replay; space plays, arrow keys step, plus and minus zoom",
    });
    this.camera = new Camera(canvas, () => this.draw(), {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(Math.round(this.step) - 1),
      ArrowRight: () => this.seek(Math.round(this.step) + 1),
      Home: () => this.seek(this.scene.now),
      End: () => this.seek(this.scene.steps - 1),
    });
    return canvas;
  }

  controls() {
    const press = (text, onclick, label = null) =>
      make("button", { type: "button", onclick, "aria-label": label }, text);
    const setSpeed = (value) => {
      playing.speed = value;
    };
    const { decisive, onset } = this.scene;
    return make(
      "div",
      { class: "controls" },
      this.button,
      this.slider,
      make(
        "label",
        {},
        "speed ",
        choice(SPEEDS, playing.speed, setSpeed, (value) => `${value} ×`),
      ),
      onset === null ? null : press("To the onset", () => this.seek(onset)),
      decisive === null ? null : press("To the contact", () => this.seek(decisive)),
      press("+", () => this.camera.zoom(1.25), "Zoom in"),
      press("−", () => this.camera.zoom(0.8), "Zoom out"),
      press("Fit", () => this.fit()),
    );
  }
}
