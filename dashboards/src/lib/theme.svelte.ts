/** Light or dark: the system's, until somebody chooses. */

const KEY = "reel-theme";
const system = matchMedia("(prefers-color-scheme: dark)");

class Theme {
  chosen = $state(localStorage.getItem(KEY));
  system = $state(system.matches);

  constructor() {
    system.addEventListener("change", (event) => (this.system = event.matches));
    if (this.chosen) document.documentElement.dataset.theme = this.chosen;
  }

  get dark(): boolean {
    return this.chosen ? this.chosen === "dark" : this.system;
  }

  toggle(): void {
    this.chosen = this.dark ? "light" : "dark";
    localStorage.setItem(KEY, this.chosen);
    document.documentElement.dataset.theme = this.chosen;
  }
}

export const theme = new Theme();
