// Requests to the server, with the token of the address. `offline.js` takes the place of this module in an exported page.

import { Refusal, unpack } from "./wire.js";

const KEPT = "needleplan token";

// Takes the token from the address and hides it there, or takes the one that this browser has kept for this port.
function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    localStorage.setItem(KEPT, given);
    history.replaceState(null, "", location.pathname);
  }
  return given ?? localStorage.getItem(KEPT) ?? "";
}

let token = "";

export function openSession() {
  token = takeToken();
  // Another tab may have opened the address of a new server.
  addEventListener("storage", () => { token = localStorage.getItem(KEPT) ?? token; });
}

// A name for this tab, so that the server knows which requests replace each other.
const tab = crypto.randomUUID();

// Sends a request. Returns what `read` makes of the response; throws Refusal with kind "away" if there is no server.
async function send(path, options, read) {
  let response;
  try {
    response = await fetch(path, { ...options, headers: { "X-Needleplan-Token": token }, cache: "no-store" });
    const isProblem = response.headers.get("Content-Type") === "application/problem+json";
    if (response.ok && !isProblem) return await read(response);
  } catch {
    throw new Refusal(0, { kind: "away", text: "The server does not answer. Start `needleplan view` again; your edits are kept." });
  }
  throw new Refusal(response.status, await response.json().catch(() => ({})));
}

export function load(path) {
  return send(path, {}, (response) => response.json());
}

// Asks for a file or a text: returns a blob.
export function fetchBlob(path, request) {
  return send(path, { method: "POST", body: JSON.stringify(request) }, (response) => response.blob());
}

export function ask(path, request) {
  const body = JSON.stringify({ ...request, tab });
  return send(path, { method: "POST", body }, async (response) => unpack(await response.arrayBuffer()));
}
