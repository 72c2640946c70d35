// SPDX-License-Identifier: Apache-2.0
// Soft tones, off until somebody asks for them.

let context = null;

export const soundIsOn = () => context !== null;

export function toggleSound() {
  if (context) {
    context.close();
    context = null;
  } else {
    context = new AudioContext();
    chime('idle');
  }
  return soundIsOn();
}

// Hertz, one after the other: rising where something begins, falling where it ends.
const kTones = {
  idle: [440], countdown: [660], capture: [660, 880], gate: [660, 550], thanks: [523, 659, 784], safe: [330, 262],
  position: [523, 587]
};

export function chime(screen) {
  if (!context) return;
  (kTones[screen] ?? []).forEach((hertz, i) => {
    const begin = context.currentTime + 0.18 * i;
    const tone = context.createOscillator(), loudness = context.createGain();
    tone.frequency.value = hertz;
    loudness.gain.setValueAtTime(0, begin);
    loudness.gain.linearRampToValueAtTime(0.15, begin + 0.02);
    loudness.gain.exponentialRampToValueAtTime(0.001, begin + 0.35);
    tone.connect(loudness).connect(context.destination);
    tone.start(begin);
    tone.stop(begin + 0.4);
  });
}
