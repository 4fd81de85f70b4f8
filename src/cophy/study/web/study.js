// The study as a jsPsych timeline. The server knows where the participant is; after each task the page asks it again.

import { PlaceObjectsPlugin } from "./plugin-place-objects.js";
import * as server from "./server.js";

const { initJsPsych, jsPsychCallFunction, jsPsychHtmlButtonResponse, jsPsychPreload } = window;
// names under which crowd platforms put a participant's id in the address
const PLATFORM_KEYS = ["participant", "PROLIFIC_PID", "workerId"];

const address = new URLSearchParams(window.location.search);
const platformId = PLATFORM_KEYS.map((key) => address.get(key)).find(Boolean) ?? null;
const jsPsych = initJsPsych({ display_element: "study" });

const [first, opening] = [await server.place(platformId), await server.welcome()];
let place = first.status === 200 ? first.data : null; // null before consent
let failure = null;
if (opening.status !== 200) failure = opening.data.error;
if (first.status !== 200 && first.status !== 401) failure = first.data.error;

const text = (html, choices) => ({ type: jsPsychHtmlButtonResponse, stimulus: html, choices });
const later = (work) => ({ type: jsPsychCallFunction, async: true, func: (done) => work().then(done) });

async function begin() {
  const { status, data } = await server.consent(platformId);
  if (status === 200) place = data;
  else failure = data.error;
}

async function refresh() {
  const { status, data } = await server.place();
  if (status === 200) place = data;
  else failure = data.error;
}

const running = () => failure === null && place !== null && !place.code;

const welcome = {
  timeline: [
    text(`<article class="text">${opening.data.html}</article>`, ["I agree, begin"]),
    later(begin),
  ],
  conditional_function: () => place === null && failure === null,
};

const gate = {
  timeline: [
    text('<article class="text"><h1>Practice is over</h1><p>Now the tasks begin. You will not see the right answers.</p></article>',
      ["Begin"]),
  ],
  conditional_function: () => place.position === place.num_practice && place.remaining_s === null,
};

const ready = {
  timeline: [
    text(() => `<article class="text"><h1>${place.clip ? "A clip, then a picture" : "Only a picture"}</h1><p>${place.clip
      ? "Watch the clip of the first scene. Then the second scene appears. Its objects have the same hidden properties. "
      : "There is no clip in this task. "}Then you have ${place.seconds} seconds to click where each object will end.</p></article>`,
      ["Ready"]),
  ],
  conditional_function: () => place.is_practice && place.remaining_s === null,
};

const preload = {
  type: jsPsychPreload,
  images: () => [place.picture],
  video: () => (place.clip ? [place.clip] : []),
  message: "Loading …",
  error_message: "A picture could not be loaded. Please load this page again.",
  continue_after_error: false,
  max_load_time: 60000,
};

const assignments = {
  timeline: [gate, ready, preload, { type: PlaceObjectsPlugin, task: () => place }, later(refresh)],
  conditional_function: running,
  loop_function: running,
};

const end = text(() => {
  if (failure !== null) return `<article class="text"><h1>This does not work</h1><p id="failure"></p></article>`;
  return `<article class="text"><h1>Thank you!</h1><p>You are done. Your completion code is</p><p class="code">${place.code}</p></article>`;
}, []);
end.on_load = () => {
  const data = document.getElementById("failure");
  if (data) data.textContent = failure;
};

await jsPsych.run([welcome, assignments, end]);
