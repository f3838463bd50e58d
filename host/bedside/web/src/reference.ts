// The reference breath: a breath that the user keeps, drawn behind each later one from its start.

import type { Ring } from "./ring";
import type { Column } from "./stream";
import type { Run } from "./sweep";

/** Columns kept of a reference breath. */
const KEPT = ["pressure", "flow", "volume"] as const satisfies readonly Column[];
type Kept = (typeof KEPT)[number];

export class Reference {
  private constructor(private readonly values: Record<Kept, Float32Array>, readonly length: number) {}

  /** The last complete breath; null if none is there. */
  static take(ring: Ring): Reference | null {
    const end = ring.breathBefore(ring.end);
    const begin = end === null ? null : ring.breathBefore(end);
    if (begin === null || end === null) return null;
    const column = (name: Kept) => Float32Array.from({ length: end - begin }, (_, index) => ring.at(name, begin + index));
    return new Reference({ pressure: column("pressure"), flow: column("flow"), volume: column("volume") }, end - begin);
  }

  at(column: Kept, age: number): number {
    return this.values[column][age] ?? Number.NaN;
  }

  /** The reference's values for consecutive samples; NaN where it is shorter than the breath. */
  along(ring: Ring, run: Run, column: Column): Float32Array {
    const values = new Float32Array(run.end - run.begin).fill(Number.NaN);
    if (column !== "pressure" && column !== "flow" && column !== "volume") return values;
    let start = ring.breathBefore(run.begin + 1);
    for (let index = run.begin; index < run.end; index++) {
      if (ring.startsBreath(index)) start = index;
      if (start !== null) values[index - run.begin] = this.at(column, ring.tickAt(index) - ring.tickAt(start));
    }
    return values;
  }
}
