// Requests to the server: the token, binary answers, and "the newest request wins".

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

export class Refusal extends Error {
  constructor(status, answer) {
    super(answer.text ?? `the server answers with status ${status}`);
    this.kind = answer.kind ?? "server";
    this.mistakes = answer.mistakes ?? [];
  }
}

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

const ARRAYS = {
  float32: Float32Array, float64: Float64Array, uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array,
};

// Reads a message of `needleplan.page._packing`: the header, with the arrays as typed arrays that have a `shape`.
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const { arrays, ...header } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  for (const [name, { dtype, shape, offset }] of Object.entries(arrays)) {
    const count = shape.reduce((product, size) => product * size, 1);
    header[name] = new ARRAYS[dtype](buffer, 4 + length + offset, count);
    header[name].shape = shape;
  }
  return header;
}

// Sends one request at a time. While one is on its way, only the newest of those that come in waits.
export class Newest {
  constructor(work) {
    this.work = work;
    this.busy = false;
    this.waiting = null;
  }

  async request(...given) {
    if (this.busy) {
      this.waiting = given;
      return;
    }
    this.busy = true;
    try {
      await this.work(...given);
    } finally {
      this.busy = false;
      const next = this.waiting;
      this.waiting = null;
      if (next) this.request(...next);
    }
  }

  forget() {
    this.waiting = null;
  }
}
