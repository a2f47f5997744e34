// In an exported page: answers from the page itself instead of a server.

import { Refusal, unpack } from "./wire.js";

const data = JSON.parse(document.getElementById("data").textContent);

export function openSession() {}

export async function load() {
  return data.start;
}

export async function ask(path) {
  const text = data.messages[path];
  if (!text) throw new Refusal(0, { kind: "offline", text: "This page is a copy without a server: it cannot plan again." });
  return unpack(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

// The code of an entry in 3D stands under its number.
export async function fetchBlob(path, { language, number }) {
  return new Blob([language ? data.code[`${language} ${number}`] ?? data.code[language] ?? "" : data.toml]);
}
