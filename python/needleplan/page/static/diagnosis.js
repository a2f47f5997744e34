// The page of a diagnosis: connects curves, panel and server.

import { isDark } from "./colours.js";
import { Curves } from "./curves.js";
import { DiagnosisPanel } from "./diagnosis_panel.js";
import { connect, save } from "./menus.js";
import { ask, fetchBlob, load, openSession } from "./net.js";

const element = (id) => document.getElementById(id);
const curves = new Curves(element("curves"), (text) => { element("live").textContent = text; });
const panel = new DiagnosisPanel(element("found"));

let silence = 0;

function say(text, stays = false) {
  clearTimeout(silence);
  element("message").textContent = text;
  element("message").hidden = !text;
  if (text && !stays) silence = setTimeout(() => say(""), 6000);
}

function paint() {
  curves.paint();
  panel.paint();
}

async function copy(language) {
  try {
    const text = await (await fetchBlob("/api/code", { language })).text();
    if (!text) throw new Error("The files of this diagnosis are not known: diagnose again.");
    await navigator.clipboard.writeText(text);
    say(`Copied: ${language === "python" ? "Python" : "commands"} that diagnose these recordings again. Files are named as they were then.`);
  } catch (refusal) {
    say(refusal.message);
  }
}

async function downloadPage() {
  try {
    save(await fetchBlob("/api/page", {}), "diagnosis.html");
  } catch (refusal) {
    say(refusal.message);
  }
}

const ACTIONS = {
  page: downloadPage,
  python: () => copy("python"),
  command: () => copy("command"),
  theme: () => {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    paint();
  },
};

connect(ACTIONS);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);

async function begin() {
  openSession();
  try {
    const opened = await load("/api/start");
    document.body.classList.toggle("offline", Boolean(opened.offline));
    element("title").textContent = opened.title;
    document.title = `${opened.title} – needleplan`;
    const found = await ask("/api/diagnosis", {});
    panel.load(found);
    curves.load(found);
    say(found.problem, true);
  } catch (refusal) {
    say(refusal.message, true);
    if (refusal.kind === "away") setTimeout(begin, 1500);
    return;
  }
  paint();
  document.body.dataset.state = "done";
}

begin();
