//! The demo's report: tables and figures.

use super::{Contestant, Demo, TRACED_PIPS};
use data::provenance::Provenance;
use learn::pipeline::Round;
use learn::simulator::episode::{Episode, episodes, split};
use learn::simulator::open_loop::predict;
use show::report::{Block, Cell, Plot, Report, Section, Series, Style, Table};

/// Number of held-out breaths whose prediction is shown.
const PREDICTIONS: usize = 3;

impl Demo {
    /// The report.
    pub fn report(&self) -> Report {
        let summary = &self.summary;
        Report {
            title: format!("Learned pressure control on {}", summary.lung),
            subtitle: format!(
                "mean error {:.3} cmH2O, best PID found {:.3} cmH2O: {:.0} % of the best PID's error",
                summary.mean.learned,
                summary.mean.pid,
                100.0 * summary.ratio()
            ),
            sections: vec![self.result(), self.pressures(), self.valves(), self.simulator(), self.training()],
            provenance: Some(Provenance {
                seed: summary.seed,
                plant: summary.lung.clone(),
                ..self.outcome.plants[0].recording.provenance.clone()
            }),
        }
    }

    fn result(&self) -> Section {
        let pids = [self.best.p_only.gains, self.best.i_only.gains, self.best.pid.gains];
        let rows: Vec<_> = self.contestants.iter().zip(pids.map(Some).into_iter().chain([None])).collect();
        let gain = |gain: Option<f32>, decimals| {
            gain.map_or_else(|| Cell::text(""), |gain| Cell::number(f64::from(gain), decimals))
        };
        let better = self.summary.ratio() < 1.0;
        let rivals = Table::of(
            "Mean error over the six waveforms, cmH2O",
            &rows,
            &[
                ("controller", &|(contestant, _)| Cell::text(contestant.name)),
                ("P %/cmH2O", &|(_, pid)| gain(pid.map(|pid| pid.p), 3)),
                ("I %/(cmH2O s)", &|(_, pid)| gain(pid.map(|pid| pid.i), 2)),
                ("D % s/cmH2O", &|(_, pid)| gain(pid.map(|pid| pid.d), 4)),
                ("error", &|(contestant, pid)| {
                    Cell::number(contestant.evaluation.mean.score, 3).best_if(pid.is_none() && better)
                }),
            ],
        );
        let seeds = self.plan.seeds.len();
        let text = format!(
            "Error is the mean of |p - target| over each inspiration, for the true airway pressure known only to the \
             bench; rise is from 10 to 90 %, overshoot the highest pressure above PIP, plateau the error \
             over the last 0.3 s. Both controllers met the same sensor noise ({seeds} seeds, none of them used \
             for tuning or training). On its learned simulator the controller scored {:.3} cmH2O.",
            self.summary.mean.learned_on_simulator
        );
        Section::new("Result", text, vec![Block::Table(self.summary.table()), Block::Table(rivals)])
    }

    fn pressures(&self) -> Section {
        let breaths = self.pressure("Three breaths", 1, 2, f64::INFINITY);
        let zooms = (0..TRACED_PIPS.len()).map(|n| self.pressure("One inspiration", n, 0, INSPIRATION_SHOWN));
        Section::new(
            "Pressure",
            "True airway pressure against the target: three breaths, then one inspiration at three PIPs.",
            vec![Block::Plot(breaths), Block::PlotRow(zooms.collect())],
        )
    }

    /// A traced waveform up to the time `until` in s, under the contestants from `first` on.
    fn pressure(&self, what: &str, traced: usize, first: usize, until: f64) -> Plot {
        let target = &self.contestants[3].traces[traced];
        let mut series = vec![Series::new("target", Style::Dashed, target.points(&target.target, until))];
        series.extend(self.contestants[first..].iter().map(|contestant| {
            let trace = &contestant.traces[traced];
            Series::new(contestant.name, Style::Line, trace.points(&trace.pressure, until))
        }));
        let title = format!("{what} at PIP {} cmH2O", TRACED_PIPS[traced]);
        Plot::new(title, "time, s", "airway pressure, cmH2O", series)
    }

    fn valves(&self) -> Section {
        let plot = |contestant: &Contestant| {
            let trace = &contestant.traces[1];
            let series = vec![
                Series::new("inspiratory", Style::Line, trace.points(&trace.u_in, 2.0)),
                Series::new("expiratory", Style::Step, trace.points(&trace.u_out_percent(), 2.0)),
            ];
            Plot::new(format!("Valves, {}", contestant.name), "time, s", "command, %", series)
        };
        Section::new(
            "Valves",
            format!("Commands of both valves at PIP {} cmH2O.", TRACED_PIPS[1]),
            vec![Block::PlotRow(self.contestants[2..].iter().map(plot).collect())],
        )
    }

    fn simulator(&self) -> Section {
        let Some(simulator) = self.outcome.plants[0].simulators.first() else { return Section::default() };
        let all = episodes(&self.outcome.plants[0].recording, simulator.architecture.timing());
        let (_, held_out) = split(&all, self.outcome.hold_out);
        let apart = (held_out.len() / PREDICTIONS).max(1);
        let shown: Vec<&Episode> = held_out.into_iter().step_by(apart).take(PREDICTIONS).collect();
        let period = f64::from(simulator.architecture.timing().period_us) * 1e-6;
        let predictions = shown.iter().zip(predict(simulator, &shown));
        let plots = predictions.map(|(episode, predicted)| prediction(episode, &predicted, period));
        let text = format!(
            "Open loop: the simulator sees the start of a held-out breath and the recorded commands, but never the \
             pressure. Its mean distance to the true airway pressure is {:.3} cmH2O.",
            self.summary.open_loop_distance
        );
        Section::new("Learned simulator", text, vec![Block::PlotRow(plots.collect())])
    }

    fn training(&self) -> Section {
        let mut fit = Vec::new();
        let (mut training, mut validation) = (Vec::new(), Vec::new());
        let (mut epochs, mut steps) = (0, 0);
        for (n, round) in self.summary.rounds.iter().enumerate() {
            let curve = round.fit_curve.iter().enumerate();
            let curve = curve.map(|(n, loss)| ((n + epochs + 1) as f64, *loss)).collect();
            fit.push(Series::new(format!("round {}", n + 1), Style::Line, curve));
            epochs += round.fit_curve.len();
            for p in &round.train_curve {
                training.push(((steps + p.iteration) as f64, p.training));
                validation.push(((steps + p.iteration) as f64, p.validation));
            }
            steps += round.train_curve.last().map_or(0, |p| p.iteration);
        }
        let fit = Plot { log_y: true, ..Plot::new("Simulator", "epoch", "loss, cmH2O", fit) };
        let train = vec![
            Series::new("training batch", Style::Line, training),
            Series::new("held-out simulator", Style::Line, validation),
        ];
        let train = Plot::new("Controller", "gradient step", "error, cmH2O", train);
        Section::new(
            "Training",
            "Each round collects with the controller learned so far, fits the simulators to everything \
             recorded and trains the controller further.",
            vec![Block::PlotRow(vec![fit, train]), Block::Table(self.rounds())],
        )
    }

    fn rounds(&self) -> Table {
        let rounds: Vec<_> = self.summary.rounds.iter().enumerate().collect();
        let open_loop = |round: &Round| round.open_loop.first().copied().unwrap_or_default();
        Table::of(
            "Rounds",
            &rounds,
            &[
                ("round", &|(n, _)| Cell::count(n + 1)),
                ("breaths", &|(_, round)| Cell::count(round.breaths)),
                ("aborted", &|(_, round)| Cell::count(round.aborts)),
                ("one-step", &|(_, round)| Cell::number(open_loop(round).one_step, 3)),
                ("open loop, measured", &|(_, round)| Cell::number(open_loop(round).measured, 3)),
                ("open loop, true", &|(_, round)| Cell::known(open_loop(round).truth, 3)),
                ("PID on simulator", &|(_, round)| Cell::number(round.base, 3)),
                ("learned", &|(_, round)| Cell::number(round.validation, 3)),
            ],
        )
    }
}

/// Length of the inspiration shown in the zoomed plots, s.
const INSPIRATION_SHOWN: f64 = 1.0;

fn prediction(episode: &Episode, predicted: &[f32], period: f64) -> Plot {
    let curve = |name: &str, values: &[f32]| {
        let points = values.iter().enumerate().map(|(n, v)| (n as f64 * period, f64::from(*v)));
        Series::new(name, Style::Line, points.collect())
    };
    let mut series = vec![curve("measured", &episode.pressure)];
    series.extend(episode.truth.as_ref().map(|truth| curve("true", truth)));
    series.push(curve("simulator", predicted));
    let title = format!("Held-out breath, PIP {:.1} cmH2O", episode.pip);
    Plot::new(title, "time, s", "pressure, cmH2O", series)
}
