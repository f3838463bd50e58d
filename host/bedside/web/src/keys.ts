// Single-key shortcuts, off while a field is typed in or a dialog is open, and the list of them.

import { inform } from "./dialog";
import { h } from "./dom";

export interface Shortcut {
  key: string;
  text: string;
  run: () => void;
}

/** Listens to the shortcuts. The user can switch them off, because speech input may press single keys. */
export function listen(shortcuts: readonly Shortcut[]): () => void {
  let on = true;
  document.addEventListener("keydown", (event) => {
    const typing = event.target instanceof Element && event.target.closest("input, select, textarea, dialog") !== null;
    if (!on || typing || event.ctrlKey || event.altKey || event.metaKey) return;
    const found = shortcuts.find(({ key }) => key === event.key.toLowerCase());
    if (found === undefined) return;
    event.preventDefault();
    found.run();
  });
  return () => {
    const rows = shortcuts.map(({ key, text }) => h("div", {}, h("dt", {}, h("kbd", {}, key)), h("dd", {}, text)));
    const box = h("input", { type: "checkbox", id: "shortcuts-on", onchange: () => { on = box.checked; } });
    box.checked = on;
    inform("Keys", h("dl", { class: "keys" }, ...rows), h("p", {}, "Arrow keys move a cursor of a frozen picture, with Shift in larger steps."),
      h("label", { class: "field" }, h("span", {}, "Single keys on"), box));
  };
}
