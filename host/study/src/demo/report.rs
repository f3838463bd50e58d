//! The job's report: tables and pictures for people who would rather look than read.

use super::{Contestant, Demo, TRACED_PIPS};
use data::provenance::Provenance;
use judge::evaluate::BreathTrace;
use learn::simulator::episode::{Episode, episodes};
use learn::simulator::fit::{predict, split};
use show::report::{Block, Cell, Plot, Report, Section, Series, Style, Table};

/// Held-out breaths whose prediction is shown.
const PREDICTIONS: usize = 3;

impl Demo {
    /// The report.
    pub fn report(&self) -> Report {
        let summary = &self.summary;
        Report {
            title: format!("Learned pressure control on {}", summary.lung),
            subtitle: format!(
                "mean error {:.3} cmH2O against {:.3} of the best PID found: {:.0} % of it",
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
        let mut rivals = Table::new(
            "Mean error over the six waveforms, cmH2O",
            &["controller", "P %/cmH2O", "I %/(cmH2O s)", "D % s/cmH2O", "error"],
        );
        let gains = [self.best.p_only.gains, self.best.i_only.gains, self.best.pid.gains];
        for (contestant, gains) in self.contestants.iter().zip(gains) {
            rivals.row(vec![
                Cell::text(contestant.name),
                Cell::number(f64::from(gains.p), 3),
                Cell::number(f64::from(gains.i), 2),
                Cell::number(f64::from(gains.d), 4),
                Cell::number(contestant.evaluation.mean.score, 3),
            ]);
        }
        let learned = &self.contestants[3];
        rivals.row(vec![
            Cell::text(learned.name),
            Cell::text(""),
            Cell::text(""),
            Cell::text(""),
            Cell::number(learned.evaluation.mean.score, 3).best_if(self.summary.ratio() < 1.0),
        ]);
        let seeds = self.plan.seeds.len();
        Section {
            heading: "Result".into(),
            text: format!(
                "Error is the mean of |p - target| over each inspiration, of the true airway pressure that only the \
                 bench knows; rise is from 10 to 90 %, overshoot the highest pressure above PIP, plateau the error \
                 over the last 0.3 s. Both controllers met the same sensor noise ({seeds} seeds, none of them used \
                 for tuning or training). On its learned simulator the controller scored {:.3} cmH2O.",
                self.summary.mean.learned_on_simulator
            ),
            blocks: vec![Block::Table(self.summary.table()), Block::Table(rivals)],
        }
    }

    fn pressures(&self) -> Section {
        let zooms = (0..TRACED_PIPS.len()).map(|n| self.zoom(n)).collect();
        Section {
            heading: "Pressure".into(),
            text:
                "True airway pressure against the target: three breaths, then one inspiration at three PIPs."
                    .into(),
            blocks: vec![Block::Plot(self.breaths(1)), Block::PlotRow(zooms)],
        }
    }

    /// All breaths of a traced waveform, PID and learned.
    fn breaths(&self, traced: usize) -> Plot {
        let mut series = vec![target(&self.contestants[3].traces[traced], f64::INFINITY)];
        series.extend(self.contestants[2..].iter().map(|c| {
            let trace = &c.traces[traced];
            Series::new(c.name, Style::Line, points(&trace.time_s, &trace.pressure, f64::INFINITY))
        }));
        Plot {
            title: format!("Three breaths at PIP {} cmH2O", TRACED_PIPS[traced]),
            x_label: "time, s".into(),
            y_label: "airway pressure, cmH2O".into(),
            series,
            ..Plot::default()
        }
    }

    /// The first inspiration of a traced waveform, all controllers.
    fn zoom(&self, traced: usize) -> Plot {
        let mut series = vec![target(&self.contestants[3].traces[traced], INSPIRATION_SHOWN)];
        series.extend(self.contestants.iter().map(|c| {
            let trace = &c.traces[traced];
            Series::new(c.name, Style::Line, points(&trace.time_s, &trace.pressure, INSPIRATION_SHOWN))
        }));
        Plot {
            title: format!("One inspiration at PIP {} cmH2O", TRACED_PIPS[traced]),
            x_label: "time, s".into(),
            y_label: "airway pressure, cmH2O".into(),
            series,
            ..Plot::default()
        }
    }

    fn valves(&self) -> Section {
        let plot = |contestant: &Contestant| {
            let trace = &contestant.traces[1];
            let out: Vec<f64> = trace.u_out.iter().map(|open| if *open { 100.0 } else { 0.0 }).collect();
            Plot {
                title: format!("Valves, {}", contestant.name),
                x_label: "time, s".into(),
                y_label: "command, %".into(),
                series: vec![
                    Series::new("inspiratory", Style::Line, points(&trace.time_s, &trace.u_in, 2.0)),
                    Series::new("expiratory", Style::Step, points(&trace.time_s, &out, 2.0)),
                ],
                ..Plot::default()
            }
        };
        Section {
            heading: "Valves".into(),
            text: format!("Commands of both valves at PIP {} cmH2O.", TRACED_PIPS[1]),
            blocks: vec![Block::PlotRow(self.contestants[2..].iter().map(plot).collect())],
        }
    }

    fn simulator(&self) -> Section {
        let Some(simulator) = self.outcome.plants[0].simulators.first() else { return Section::default() };
        let all = episodes(&self.outcome.plants[0].recording, simulator.architecture.timing());
        let (_, held_out) = split(&all, self.outcome.hold_out);
        let shown: Vec<&Episode> = held_out
            .iter()
            .step_by((held_out.len() / PREDICTIONS).max(1))
            .take(PREDICTIONS)
            .copied()
            .collect();
        let period = f64::from(simulator.architecture.timing().period_us) * 1e-6;
        let plots = shown
            .iter()
            .zip(predict(simulator, &shown))
            .map(|(episode, predicted)| prediction(episode, &predicted, period))
            .collect();
        Section {
            heading: "Learned simulator".into(),
            text: format!(
                "Open loop: the simulator sees how a held-out breath starts and the recorded commands, never its \
                 pressure. Its mean distance to the true airway pressure is {:.3} cmH2O.",
                self.summary.open_loop_distance
            ),
            blocks: vec![Block::PlotRow(plots)],
        }
    }

    fn training(&self) -> Section {
        let rounds = &self.summary.rounds;
        let curve = |values: &[f64], offset: usize| -> Vec<(f64, f64)> {
            values.iter().enumerate().map(|(n, v)| ((n + offset + 1) as f64, *v)).collect()
        };
        let mut fit = Vec::new();
        let (mut training, mut validation) = (Vec::new(), Vec::new());
        let (mut epochs, mut steps) = (0, 0);
        for (n, round) in rounds.iter().enumerate() {
            fit.push(Series::new(format!("round {}", n + 1), Style::Line, curve(&round.fit_curve, epochs)));
            epochs += round.fit_curve.len();
            for p in &round.train_curve {
                training.push(((steps + p.iteration) as f64, p.training));
                validation.push(((steps + p.iteration) as f64, p.validation));
            }
            steps += round.train_curve.last().map_or(0, |p| p.iteration);
        }
        let fit = Plot {
            title: "Simulator".into(),
            x_label: "epoch".into(),
            y_label: "loss, cmH2O".into(),
            series: fit,
            log_y: true,
            ..Plot::default()
        };
        let train = Plot {
            title: "Controller".into(),
            x_label: "gradient step".into(),
            y_label: "error, cmH2O".into(),
            series: vec![
                Series::new("training batch", Style::Line, training),
                Series::new("held-out simulator", Style::Line, validation),
            ],
            ..Plot::default()
        };
        Section {
            heading: "Training".into(),
            text:
                "Each round collects with the controller learned so far, fits the simulators to everything \
                   recorded and trains the controller further."
                    .into(),
            blocks: vec![Block::PlotRow(vec![fit, train]), Block::Table(self.rounds())],
        }
    }

    fn rounds(&self) -> Table {
        let mut table = Table::new(
            "Rounds",
            &[
                "round",
                "breaths",
                "aborted",
                "one-step",
                "open loop, measured",
                "open loop, true",
                "PID on simulator",
                "learned",
            ],
        );
        for (n, round) in self.summary.rounds.iter().enumerate() {
            let open_loop = round.open_loop.first().copied().unwrap_or_default();
            table.row(vec![
                Cell::count(n + 1),
                Cell::count(round.breaths),
                Cell::count(round.aborts),
                Cell::number(open_loop.one_step, 3),
                Cell::number(open_loop.measured, 3),
                open_loop.truth.map_or_else(|| Cell::right("-"), |truth| Cell::number(truth, 3)),
                Cell::number(round.base, 3),
                Cell::number(round.validation, 3),
            ]);
        }
        table
    }
}

/// How much of a breath the zooms show, s.
const INSPIRATION_SHOWN: f64 = 1.0;

fn points(time: &[f64], values: &[f64], until: f64) -> Vec<(f64, f64)> {
    time.iter().copied().zip(values.iter().copied()).take_while(|(t, _)| *t < until).collect()
}

fn target(trace: &BreathTrace, until: f64) -> Series {
    Series::new("target", Style::Dashed, points(&trace.time_s, &trace.target, until))
}

fn prediction(episode: &Episode, predicted: &[f32], period: f64) -> Plot {
    let curve = |values: &[f32]| -> Vec<(f64, f64)> {
        values.iter().enumerate().map(|(n, v)| (n as f64 * period, f64::from(*v))).collect()
    };
    let mut series = vec![Series::new("measured", Style::Line, curve(&episode.pressure))];
    if let Some(truth) = &episode.truth {
        series.push(Series::new("true", Style::Line, curve(truth)));
    }
    series.push(Series::new("simulator", Style::Line, curve(predicted)));
    Plot {
        title: format!("Held-out breath, PIP {:.1} cmH2O", episode.pip),
        x_label: "time, s".into(),
        y_label: "pressure, cmH2O".into(),
        series,
        ..Plot::default()
    }
}
