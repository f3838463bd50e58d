// The strips of the bedside view from top to bottom: which curves each shows, in which unit and scale.

import { colour } from "./dom";
import type { Mark } from "./frame";
import type { Trace } from "./layer";
import type { State } from "./stream";

export interface Strip {
  id: string;
  /** Text of the axis. */
  label: string;
  /** Name for a screen reader. */
  name: string;
  /** Part of the height. */
  share: number;
  /** Whether it is estimated without a flow sensor. */
  estimated: boolean;
  traces: Trace[];
  /** Names and colours of the curves. */
  legend: [string, string][];
  /** How the scale follows the values: fixed ends, from zero, or both ways around zero. */
  scale: "pressure" | "up" | "around" | "percent" | "share";
}

export function strips(): Strip[] {
  const [pressure, target, flow, volume] = [colour("--pressure"), colour("--target"), colour("--flow"), colour("--volume")];
  const [valve, exhale, learned, reference] = [colour("--valve"), colour("--exhale"), colour("--learned"), colour("--reference")];
  return [
    {
      id: "pressure", label: "cmH2O", name: "Pressure and target", share: 3, estimated: false, scale: "pressure",
      traces: [{ column: "target", colour: target, width: 1.25 }, { column: "pressure", colour: pressure, width: 2, reference }],
      legend: [["Pressure", pressure], ["target", target]],
    },
    {
      id: "flow", label: "L/min", name: "Flow", share: 2, estimated: true, scale: "around",
      traces: [{ column: "flow", colour: flow, width: 1.75, factor: 60, reference }],
      legend: [["Flow", flow]],
    },
    {
      id: "volume", label: "mL", name: "Volume", share: 2, estimated: true, scale: "up",
      traces: [{ column: "volume", colour: volume, width: 1.75, reference }],
      legend: [["Volume", volume]],
    },
    {
      id: "valves", label: "%", name: "Valve commands", share: 1.5, estimated: false, scale: "percent",
      traces: [{ column: "u_out", colour: exhale, width: 1, fill: true }, { column: "u_in", colour: valve, width: 1.5 }],
      legend: [["Valves: inspiratory", valve], ["expiratory open", colour("--exhale-text")]],
    },
    {
      id: "learned", label: "%", name: "Learned part, % of valve", share: 1.2, estimated: false, scale: "share",
      traces: [{ column: "learned", colour: learned, width: 1.5 }],
      legend: [["Learned part, % of valve", learned]],
    },
  ];
}

/** The limit lines of the pressure. */
export function pressureMarks(state: State | null): Mark[] {
  if (state === null) return [];
  const mark = (name: string, text: string, hue: string): Mark[] => {
    const value = state.settings[name];
    return value === undefined ? [] : [{ value, text: `${text} ${Number(value.toPrecision(4))}`, colour: colour(hue) }];
  };
  return [...mark("pressure_limit", "limit", "--limit"), ...mark("pip", "PIP", "--line"), ...mark("peep", "PEEP", "--line")];
}
