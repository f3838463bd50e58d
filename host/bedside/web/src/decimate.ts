// Min-max decimation: at most four points for each pixel column, and no spike is lost.
//
// A column keeps its first, lowest, highest and last value in the order of time, so that the line through the points has the
// same extremes in each column, and joins its neighbours, as the line through all samples.

/** Points of a line: x in pixels, y in the unit of the values; NaN breaks the line. */
export interface Points {
  x: number[];
  y: number[];
}

/** The extremes of one column while it is filled. */
interface Open {
  column: number;
  first: [number, number];
  low: [number, number];
  high: [number, number];
  last: [number, number];
}

/**
 * Decimates `count` values. `x` and `y` give the position in pixels and the value of each; positions must not fall.
 * A value that is not a number breaks the line.
 */
export function decimate(count: number, x: (index: number) => number, y: (index: number) => number): Points {
  const points: Points = { x: [], y: [] };
  let open: Open | null = null;
  for (let index = 0; index < count; index++) {
    const [at, value] = [x(index), y(index)];
    if (!Number.isFinite(value)) {
      close(points, open);
      open = null;
      breakLine(points, at);
    } else if (open !== null && Math.floor(at) === open.column) {
      extend(open, at, value);
    } else {
      close(points, open);
      const point: [number, number] = [at, value];
      open = { column: Math.floor(at), first: point, low: point, high: point, last: point };
    }
  }
  close(points, open);
  return points;
}

function extend(open: Open, x: number, y: number): void {
  open.last = [x, y];
  if (y < open.low[1]) open.low = open.last;
  if (y > open.high[1]) open.high = open.last;
}

function breakLine(points: Points, x: number): void {
  const last = points.y.at(-1);
  if (last === undefined || Number.isNaN(last)) return;
  points.x.push(x);
  points.y.push(Number.NaN);
}

function close(points: Points, open: Open | null): void {
  if (open === null) return;
  const [early, late] = open.low[0] <= open.high[0] ? [open.low, open.high] : [open.high, open.low];
  let known: [number, number] | null = null;
  for (const point of [open.first, early, late, open.last]) {
    // The same sample may be first and lowest.
    if (point === known) continue;
    points.x.push(point[0]);
    points.y.push(point[1]);
    known = point;
  }
}
