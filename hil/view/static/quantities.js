// Units as people read them, and how numbers are written: always the same width, always the same digits.

export const FACTORS = Object.fromEntries([
  ...["position_m", "ref_position_m", "est_position_m", "ref_velocity_mps", "est_velocity_mps"].map((n) => [n, 1e3]),
  ...["pressure_a_pa", "pressure_b_pa"].flatMap((n) =>
    ["", "est_", "low_", "high_"].map((side) => [side + n, 1e-5]),
  ),
  ...["residual_a_pa", "residual_b_pa", "threshold_a_pa", "threshold_b_pa"].map((n) => [n, 1e-5]),
]);

// A number with fixed decimals and a true minus sign; a dash where there is none.
export function figure(value, digits) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `−${text}` : text;
}

// Microseconds with three digits that matter.
export function micros(value) {
  if (value === null || value === undefined) return "–";
  return value >= 100 ? Math.round(value).toLocaleString("en").replaceAll(",", "\u202f") : value.toFixed(1);
}

export function clock(seconds) {
  return figure(seconds, 2);
}

// Text of an element, written only when it changes: the browser then has nothing to lay out.
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
