"use strict";
(() => {
  // Colors follow the system or the user's choice. The event "colors" announces a change.
  const root = document.documentElement, button = document.getElementById("theme");
  const NAMES = { "": "auto", light: "light", dark: "dark" };
  const tell = () => root.dispatchEvent(new Event("colors"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", tell);
  button.addEventListener("click", () => {
    const names = Object.keys(NAMES), next = names[(names.indexOf(root.dataset.theme || "") + 1) % names.length];
    if (next) root.dataset.theme = next; else delete root.dataset.theme;
    button.textContent = `Colors: ${NAMES[next]}`;
    tell();
  });
})();
