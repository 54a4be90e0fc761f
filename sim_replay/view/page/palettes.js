// Colours of echo codes: code 0 is no echo, code n is -40 dB + (n - 1) / 4 dB about the local sea floor.

const STOPS = {
  copper: [[10, 7, 6], [66, 32, 17], [150, 82, 33], [222, 152, 70], [255, 240, 208]],
  grey: [[0, 0, 0], [255, 255, 255]],
  "grey, inverted": [[255, 255, 255], [0, 0, 0]],
  amber: [[0, 0, 0], [90, 45, 0], [200, 120, 10], [255, 225, 150]],
  ice: [[4, 8, 20], [18, 60, 110], [90, 170, 210], [240, 252, 255]],
  "night red": [[0, 0, 0], [70, 8, 4], [150, 28, 16], [230, 80, 50]],
};
const EMPTY = {day: [214, 221, 226], dusk: [30, 39, 50], night: [8, 2, 2]};

export const NAMES = Object.keys(STOPS);
export const OF_THEME = {day: "grey", dusk: "copper", night: "night red"};

// A little-endian RGBA word per code. gain, contrast: decibels that the middle is raised by, and from black to white.
export function table(name, gain, contrast, theme) {
  const stops = STOPS[name] || STOPS.copper;
  const words = new Uint32Array(256);
  words[0] = word(EMPTY[theme] || EMPTY.dusk);
  for (let code = 1; code < 256; code++) {
    const level = -40 + (code - 1) / 4 + gain;
    const share = Math.min(1, Math.max(0, (level + 1.5) / contrast + 0.5));
    const place = share * (stops.length - 1), below = Math.min(Math.floor(place), stops.length - 2);
    words[code] = word(stops[below].map((value, channel) =>
      Math.round(value + (place - below) * (stops[below + 1][channel] - value))));
  }
  return words;
}

const word = ([red, green, blue]) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
