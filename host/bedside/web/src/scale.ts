// Scales of the pictures: round numbers that hold the values, stable from sweep to sweep. Pure.

/** Steps of a scale's end. */
const STEPS = [1, 2, 5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 600, 800, 1000, 1500, 2000, 3000];

/** The lowest step that is not below a value. */
export function roundUp(value: number): number {
  return STEPS.find((step) => step >= value) ?? STEPS.at(-1) ?? value;
}

/** An end of a scale: grows at once, shrinks only if `mayShrink`. */
export function end(known: number, value: number, mayShrink: boolean): number {
  const wanted = roundUp(value);
  return wanted > known || mayShrink ? wanted : known;
}

/** Lowest and highest of some values; zero if there are none. */
export function extremes(count: number, value: (index: number) => number): [number, number] {
  let [low, high] = [0, 0];
  for (let index = 0; index < count; index++) {
    const one = value(index);
    if (one < low) low = one;
    if (one > high) high = one;
  }
  return [low, high];
}
