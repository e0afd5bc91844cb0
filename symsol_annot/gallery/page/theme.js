// Light, dark, or as the system says; remembered where the browser lets a page from disk remember.
"use strict";

window.SYMSOL = window.SYMSOL || {};

SYMSOL.theme = (() => {
  const order = ["auto", "light", "dark"];
  const words = { auto: "◐ Auto", light: "○ Light", dark: "● Dark" };
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const listeners = [];
  let chosen = "auto";

  function remember(value) {
    try { window.localStorage.setItem("symsol-theme", value); } catch { /* not allowed: then not */ }
  }

  function remembered() {
    try { return window.localStorage.getItem("symsol-theme"); } catch { return null; }
  }

  function apply(value) {
    chosen = order.includes(value) ? value : "auto";
    const isDark = chosen === "dark" || (chosen === "auto" && system.matches);
    document.documentElement.dataset.theme = isDark ? "dark" : "light";
    listeners.forEach((listener) => listener());
  }

  function connect(button) {
    const label = () => {
      button.textContent = words[chosen];
      button.setAttribute("aria-label", `Colours: ${chosen}. Press for ${order[(order.indexOf(chosen) + 1) % 3]}`);
    };
    button.addEventListener("click", () => {
      apply(order[(order.indexOf(chosen) + 1) % 3]);
      remember(chosen);
      label();
    });
    label();
  }

  system.addEventListener("change", () => apply(chosen));
  apply(remembered());
  return {
    connect,
    onChange: (listener) => listeners.push(listener),
    colour: (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim(),
  };
})();
