/** A short tone when a question begins to wait. Off until somebody turns it on; this browser remembers. */

const KEY = "reel-sound";
const HERTZ = 660;
const SECONDS = 0.25;

class Sound {
  on = $state(localStorage.getItem(KEY) === "on");
  #context?: AudioContext;

  /** Turned on it sounds once, which lets a person hear it and the browser allow it. */
  toggle(): void {
    this.on = !this.on;
    localStorage.setItem(KEY, this.on ? "on" : "off");
    if (this.on) this.beep();
  }

  beep(): void {
    const context = (this.#context ??= new AudioContext());
    // Browsers keep a page silent until somebody has clicked on it.
    void context.resume();
    const [tone, volume] = [context.createOscillator(), context.createGain()];
    tone.frequency.value = HERTZ;
    volume.gain.setValueAtTime(0.2, context.currentTime);
    volume.gain.exponentialRampToValueAtTime(0.001, context.currentTime + SECONDS);
    tone.connect(volume).connect(context.destination);
    tone.start();
    tone.stop(context.currentTime + SECONDS);
  }
}

export const sound = new Sound();
