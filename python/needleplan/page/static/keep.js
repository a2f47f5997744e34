// Keeps the edited document in the browser, so that a reload, a crash or a new server loses no work.

export class Keep {
  // `digest` is that of the scenario as it was opened; edits of another scenario are not offered.
  constructor(digest) {
    this.key = `needleplan edits ${digest}`;
  }

  // Returns the kept document, or null. A tab prefers its own to that of other tabs.
  load() {
    for (const storage of [sessionStorage, localStorage]) {
      try {
        const kept = JSON.parse(storage.getItem(this.key));
        if (kept?.scenario?.workspace) return kept;
      } catch {
        storage.removeItem(this.key);
      }
    }
    return null;
  }

  save(document) {
    for (const storage of [sessionStorage, localStorage]) {
      try {
        storage.setItem(this.key, JSON.stringify(document));
      } catch {
        // The storage is full or forbidden; the page goes on without it.
      }
    }
  }
}
