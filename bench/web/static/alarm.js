// The alarm of a run that tripped: three tones, and a title that blinks until the page is touched.

export function alarm(words) {
  const title = document.title;
  let shown = false;
  const blink = setInterval(() => { shown = !shown; document.title = shown ? `\u25cf TRIPPED: ${words}` : title; }, 600);
  const quiet = () => { clearInterval(blink); document.title = title; removeEventListener("pointerdown", quiet); removeEventListener("keydown", quiet); };
  addEventListener("pointerdown", quiet);
  addEventListener("keydown", quiet);
  const Sound = window.AudioContext ?? window.webkitAudioContext;
  if (!Sound) return;
  const sound = new Sound(), loudness = sound.createGain();
  loudness.gain.value = 0.2;
  loudness.connect(sound.destination);
  for (const k of [0, 1, 2]) {
    const tone = sound.createOscillator();
    tone.frequency.value = 880;
    tone.connect(loudness);
    tone.start(sound.currentTime + 0.4 * k);
    tone.stop(sound.currentTime + 0.4 * k + 0.2);
  }
}
