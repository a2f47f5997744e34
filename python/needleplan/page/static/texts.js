// Elements and words that all panels share.

export function percent(share) {
  return `${(100 * share).toFixed(1)} %`;
}

export function roleWords(role) {
  return { holdout: "held out", reference: "reference" }[role] ?? "training";
}

export function make(tag, text = "") {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  return element;
}
