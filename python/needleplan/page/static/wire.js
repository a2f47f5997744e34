// Messages of the server, why it refuses, and "the newest request wins".

export class Refusal extends Error {
  constructor(status, answer) {
    super(answer.text ?? `the server answers with status ${status}`);
    this.kind = answer.kind ?? "server";
    this.mistakes = answer.mistakes ?? [];
  }
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
