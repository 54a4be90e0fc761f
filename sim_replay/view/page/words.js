// Write numbers and places for people.

export function degreesMinutes(value, positive, negative) {
  if (value === null || !isFinite(value)) return "?";
  const minutes = Math.round(Math.abs(value) * 60e4) / 1e4;
  const whole = Math.floor(minutes / 60);
  return `${whole}° ${(minutes - 60 * whole).toFixed(4).padStart(7, "0")}′ ${value < 0 ? negative : positive}`;
}

export function position(latitude, longitude) {
  return `${degreesMinutes(latitude, "N", "S")}  ${degreesMinutes(longitude, "E", "W")}`;
}

export function metres(value, digits = 1) {
  return value === null || value === undefined || !isFinite(value) ? "?" : `${value.toFixed(digits)} m`;
}

export function clock(seconds) {
  return seconds === null || !isFinite(seconds) ? "" : new Date(1000 * seconds).toISOString().slice(11, 19);
}

export const plain = (name) => String(name).replaceAll("_", " ");

export const CALLS = {mine_like: "mine-like", not_mine_like: "not mine-like", undecided: "undecided"};

// The step 1, 2 or 5 times a power of ten that puts about n marks over a length.
export function niceStep(length, n) {
  const rough = length / n, power = 10 ** Math.floor(Math.log10(rough));
  return power * ([1, 2, 5, 10].find((step) => step * power >= rough) || 10);
}
