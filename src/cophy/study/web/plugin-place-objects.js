// A jsPsych plugin: one task. The clip plays once if there is one; then the image appears and the clock begins.

import { Board, icon } from "./board.js";
import * as server from "./server.js";

const { ParameterType } = window.jsPsychModule;
const STEP_PX = 4;
const FAST_STEP_PX = 20; // while Shift is held, or an arrow key is held down
const MOVES = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const PAGE = `
  <div class="task">
    <p class="progress"><span class="count"></span><progress></progress></p>
    <p class="say" aria-live="polite"></p>
    <div class="scenes">
      <figure class="before"><video muted playsinline></video><figcaption>First scene</figcaption></figure>
      <figure class="after"><div class="frame"></div><figcaption></figcaption></figure>
    </div>
    <p class="clock"><progress max="1" value="1"></progress><output></output></p>
    <ol class="objects"></ol>
    <p class="buttons">
      <button class="undo" type="button" disabled>Undo</button>
      <button class="label" type="button" aria-pressed="false">Show names</button>
      <button class="done" type="button" disabled>Done</button>
    </p>
    <p class="keys">Keys: arrows move the cross (with Shift faster), Enter sets it, Backspace undoes, N shows names,
      D is Done.</p>
  </div>`;

export class PlaceObjectsPlugin {
  static info = {
    name: "place-objects",
    version: "1.0.0",
    parameters: { task: { type: ParameterType.OBJECT, default: undefined } },
    data: { position: { type: ParameterType.INT }, stored: { type: ParameterType.BOOL } },
  };

  constructor(jsPsych) {
    this.jsPsych = jsPsych;
  }

  async trial(root, trial) {
    this.task = trial.task;
    this.clicks = new Map();
    this.order = []; // slots as they were clicked
    this.undone = 0;
    this.namesShown = false;
    this.input = "none";
    this.cross = { x: this.task.resolution / 2, y: this.task.resolution / 2 };
    this.running = false;
    root.innerHTML = PAGE;
    this.part = (selector) => root.querySelector(selector);
    this.#describe();
    if (this.task.clip) await this.#watch();
    await this.#run();
    if (this.expired) return this.#end(false);
    const content = this.#content();
    let { status, data } = await server.answer(this.task.position, content);
    while (server.isBusy(status)) {
      await this.#showAndWait("Your answer could not be stored yet. Please try again.", "Try again");
      ({ status, data } = await server.answer(this.task.position, content));
    }
    if (data.ends) await this.#compare(data.ends);
    this.#end(status === 200);
  }

  #end(stored) {
    this.jsPsych.finishTrial({ position: this.task.position, stored });
  }

  #describe() {
    const { task } = this;
    const number = task.is_practice ? task.position + 1 : task.position - task.num_practice + 1;
    const total = task.is_practice ? task.num_practice : task.num_positions - task.num_practice;
    this.part(".count").textContent = `${task.is_practice ? "Practice" : "Task"} ${number} of ${total}`;
    Object.assign(this.part(".progress progress"), { max: task.num_positions, value: task.position });
    this.part(".before").hidden = !task.clip;
    this.part(".task").classList.toggle("two", Boolean(task.clip));
    this.part(".after figcaption").textContent = task.clip ? "Second scene: how will it end?" : "How will it end?";
    this.part(".clock output").textContent = `${task.seconds} s`;
    task.objects.forEach((object, index) => {
      const item = document.createElement("li");
      item.append(icon(object, index), object.name);
      this.part(".objects").append(item);
    });
  }

  // Play AB once before C appears, so that C is visible equally long in both settings.
  async #watch() {
    this.part(".say").textContent = "Watch the first scene.";
    this.part(".task").classList.add("watching");
    const video = this.part("video");
    video.src = this.jsPsych.pluginAPI.getVideoBuffer(this.task.clip);
    const ended = new Promise((done) => video.addEventListener("ended", done, { once: true }));
    if (this.task.remaining_s === null) {
      await this.#play(video);
      await ended;
    }
    video.loop = true;
    video.play().catch(() => {}); // it was seen once and may stand still
    this.part(".task").classList.remove("watching");
  }

  // Some browsers do not play a clip before a button is pressed, to save power.
  async #play(video) {
    for (;;) {
      try {
        return await video.play();
      } catch (error) {
        const refused = error.name === "NotAllowedError";
        this.part(".say").textContent = refused
          ? "Press Play to watch the first scene." : "This browser cannot play the clip. Please take another one.";
        await this.#waitForPress(refused ? "Play" : "Try again");
        this.part(".say").textContent = "Watch the first scene.";
      }
    }
  }

  async #run() {
    const image = new Image();
    Object.assign(image, { src: this.task.picture, alt: "", draggable: false });
    await image.decode(); // before the clock begins
    const board = this.board = new Board(this.part(".frame"), this.task, image);
    const { status, data } = await server.begin(this.task.position);
    if (status !== 200 || data.position !== this.task.position) {
      this.expired = true; // the time of this task is over: it was begun before
      return;
    }
    this.began = performance.now() - 1000 * (this.task.seconds - data.remaining_s);
    this.running = true;
    await new Promise((done) => {
      this.finish = done;
      this.#listen(board.svg);
      board.svg.focus({ preventScroll: true });
      this.#update();
      this.#tick();
    });
    this.running = false;
    document.removeEventListener("keydown", this.onKey);
  }

  #elapsed() {
    return performance.now() - this.began;
  }

  #tick() {
    if (!this.running) return;
    const left = this.task.seconds - this.#elapsed() / 1000;
    this.part(".clock progress").value = Math.max(0, left / this.task.seconds);
    this.part(".clock output").textContent = `${Math.max(0, Math.ceil(left))} s`;
    this.part(".clock").classList.toggle("soon", left < 3);
    if (left <= 0) this.finish();
    else setTimeout(() => this.#tick(), 100);
  }

  #listen(svg) {
    svg.addEventListener("pointerdown", (event) => {
      const at = this.board.at(event);
      if (at === null || !this.running || event.button !== 0) return;
      event.preventDefault();
      this.board.showCross(null);
      this.#set(at, event.pointerType || "mouse");
    });
    this.onKey = (event) => this.#key(event);
    document.addEventListener("keydown", this.onKey);
    this.part(".undo").addEventListener("click", () => this.#undo());
    this.part(".label").addEventListener("click", () => this.#toggleNames());
    this.part(".done").addEventListener("click", () => this.#done());
  }

  #key(event) {
    const onButton = event.target instanceof HTMLButtonElement;
    if (event.ctrlKey || event.altKey || event.metaKey || !this.running) return;
    if (event.key in MOVES) this.#move(MOVES[event.key], event.shiftKey || event.repeat ? FAST_STEP_PX : STEP_PX);
    else if (event.key === "Enter" && !onButton) this.#set({ ...this.cross }, "keyboard");
    else if (event.key === "Backspace") this.#undo();
    else if (event.key.toLowerCase() === "n") this.#toggleNames();
    else if (event.key.toLowerCase() === "d") this.#done();
    else return;
    event.preventDefault();
  }

  #move([x, y], step) {
    const clamp = (value) => Math.min(this.task.resolution, Math.max(0, value));
    this.cross = { x: clamp(this.cross.x + step * x), y: clamp(this.cross.y + step * y) };
    this.board.showCross(this.cross);
  }

  #next() {
    return this.task.objects.find((object) => !this.clicks.has(object.slot));
  }

  #set(at, input) {
    const next = this.#next();
    const at_ms = Math.max(0, Math.round(this.#elapsed()));
    if (!next || at_ms > 1000 * this.task.seconds) return;
    this.clicks.set(next.slot, { ...at, at_ms });
    this.order.push(next.slot);
    this.input = input;
    this.#update();
  }

  #undo() {
    if (!this.running || !this.order.length) return;
    this.clicks.delete(this.order.pop());
    this.undone += 1;
    this.#update();
  }

  #toggleNames() {
    const button = this.part(".label");
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    this.namesShown ||= shown;
    this.board.showNames(shown);
  }

  #done() {
    if (this.running && !this.#next()) this.finish();
  }

  // Show what to click next, and what was clicked.
  #update() {
    const next = this.#next();
    const say = this.part(".say");
    if (next) {
      const name = document.createElement("strong");
      name.append(icon(next, this.task.objects.indexOf(next)), next.name);
      say.replaceChildren("Click where the ", name, " object will end.");
    } else {
      say.textContent = "All set. Undo to change, or press Done.";
    }
    this.part(".done").disabled = Boolean(next);
    this.part(".undo").disabled = !this.order.length;
    const items = [...this.part(".objects").children];
    this.task.objects.forEach((object, index) => {
      items[index].classList.toggle("set", this.clicks.has(object.slot));
      items[index].classList.toggle("next", object === next);
    });
    this.board.draw(this.task.objects, this.clicks);
  }

  #content() {
    return {
      clicks: [...this.clicks].map(([slot, click]) => ({ slot, ...click })),
      undone: this.undone,
      names_shown: this.namesShown,
      input: this.input,
      window: [window.innerWidth, window.innerHeight],
    };
  }

  async #compare(ends) {
    this.board.showCross(null);
    this.board.drawEnds(this.task.objects, this.clicks, ends);
    const marks = this.clicks.size ? " Your marks are joined to them." : "";
    const over = this.#next() ? "Time is up. " : "";
    await this.#showAndWait(`${over}Practice: the large circles show where the objects ended.${marks}`, "Continue");
  }

  // Show a text and wait until the participant presses the only button.
  async #showAndWait(text, label) {
    this.part(".say").textContent = text;
    this.part(".clock").hidden = this.part(".keys").hidden = true;
    for (const item of this.part(".objects").children) item.classList.remove("next");
    this.part(".undo").hidden = this.part(".label").hidden = true;
    await this.#waitForPress(label);
  }

  async #waitForPress(label) {
    const button = this.part(".done");
    const before = button.textContent;
    Object.assign(button, { disabled: false, textContent: label });
    button.focus();
    await new Promise((done) => button.addEventListener("click", done, { once: true }));
    Object.assign(button, { disabled: true, textContent: before });
  }
}
