// Dialogs by the browser's own element: it keeps the focus inside, Escape cancels, and the focus returns afterwards.

import { button, h } from "./dom";

/** Asks for a confirmation. The focus starts on "Cancel". */
export function confirm(title: string, lines: readonly string[], action: string): Promise<boolean> {
  return new Promise((resolve) => {
    let agreed = false;
    const cancel = button("Cancel", () => dialog.close(), { class: "cancel" });
    const agree = button(action, () => { agreed = true; dialog.close(); }, { class: "agree" });
    const dialog = frame(title, ...lines.map((line) => h("p", {}, line)), h("div", { class: "row" }, cancel, agree));
    open(dialog, () => resolve(agreed));
    cancel.focus();
  });
}

/** Shows content until it is closed. */
export function inform(title: string, ...content: Node[]): void {
  const close = button("Close", () => dialog.close());
  const dialog = frame(title, ...content, h("div", { class: "row" }, close));
  open(dialog, () => {});
  close.focus();
}

function frame(title: string, ...content: Node[]): HTMLDialogElement {
  const heading = h("h2", { id: "dialog-title" }, title);
  return h("dialog", { "aria-labelledby": "dialog-title" }, heading, ...content);
}

function open(dialog: HTMLDialogElement, closed: () => void): void {
  const before = document.activeElement;
  document.body.append(dialog);
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (before instanceof HTMLElement) before.focus();
    closed();
  });
  dialog.showModal();
}
