// Tabs by the pattern of ARIA: arrow keys move between them, and only the chosen one is in the order of Tab.

import { h, setAttribute, show } from "./dom";

export interface Tab {
  id: string;
  text: string;
  content: HTMLElement;
}

export class Tabs {
  readonly element = h("section", { class: "panel", "aria-label": "Panel" });
  private readonly list = h("div", { class: "tabs", role: "tablist", "aria-label": "Panel" });
  private readonly parts: { tab: HTMLButtonElement; page: HTMLElement; id: string }[];

  constructor(tabs: readonly Tab[]) {
    this.parts = tabs.map(({ id, text, content }, index) => {
      const tab = h("button", {
        type: "button", role: "tab", id: `tab-${id}`, "aria-controls": `page-${id}`,
        onclick: () => this.choose(id), onkeydown: (event) => this.key(event as KeyboardEvent, index),
      }, text);
      const page = h("div", { role: "tabpanel", id: `page-${id}`, "aria-labelledby": `tab-${id}`, class: "page", tabindex: "0" }, content);
      return { tab, page, id };
    });
    this.list.append(...this.parts.map(({ tab }) => tab));
    this.element.append(this.list, ...this.parts.map(({ page }) => page));
    this.choose(tabs[0]?.id ?? "");
  }

  choose(id: string): void {
    for (const part of this.parts) {
      const chosen = part.id === id;
      setAttribute(part.tab, "aria-selected", String(chosen));
      part.tab.tabIndex = chosen ? 0 : -1;
      show(part.page, chosen);
    }
  }

  /** Offers a tab, or hides it; if it was chosen, the first one is. */
  offer(id: string, on: boolean): void {
    const part = this.parts.find((one) => one.id === id);
    if (part === undefined || part.tab.hidden === !on) return;
    show(part.tab, on);
    if (!on && part.tab.tabIndex === 0) this.choose(this.parts[0]?.id ?? "");
  }

  /** Chooses a tab and moves the focus to it. */
  focus(id: string): void {
    this.choose(id);
    this.parts.find((part) => part.id === id)?.tab.focus();
  }

  private key(event: KeyboardEvent, index: number): void {
    const offered = this.parts.filter(({ tab }) => !tab.hidden);
    const [count, own] = [offered.length, offered.findIndex(({ id }) => id === this.parts[index]?.id)];
    const next: Record<string, number> = { ArrowRight: (own + 1) % count, ArrowLeft: (own + count - 1) % count, Home: 0, End: count - 1 };
    const part = offered[next[event.key] ?? -1];
    if (part === undefined) return;
    event.preventDefault();
    this.focus(part.id);
  }
}
