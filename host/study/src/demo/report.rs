//! The demo's report: tables and figures.

use super::{Contestant, Demo, TRACED_PIPS};
use crate::prediction;
use data::provenance::Provenance;
use learn::pipeline::Round;
use learn::simulator::episode::{Episode, episodes, split};
use learn::simulator::open_loop::predict;
use score::evaluate::BreathTrace;
use show::report::{Block, Cell, Plot, Report, ReportError, Section, Series, Style, Table};

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
                source: "trainer demo".into(),
                notes: Vec::new(),
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
            "Means over the six waveforms",
            &rows,
            &[
                ("controller", &|(contestant, _)| Cell::text(contestant.name)),
                ("P %/cmH2O", &|(_, pid)| gain(pid.map(|pid| pid.p), 3)),
                ("I %/(cmH2O s)", &|(_, pid)| gain(pid.map(|pid| pid.i), 2)),
                ("D % s/cmH2O", &|(_, pid)| gain(pid.map(|pid| pid.d), 4)),
                ("error, cmH2O", &|(contestant, pid)| {
                    Cell::number(contestant.evaluation.mean.score, 3).best_if(pid.is_none() && better)
                }),
                ("valve effort, %/s", &|(contestant, _)| {
                    Cell::number(contestant.evaluation.mean.effort.total_variation, 0)
                }),
            ],
        );
        let seeds = self.plan.seeds.len();
        let text = format!(
            "Error is the mean of |p - target| over each inspiration, for the true airway pressure known only to the \
             bench; rise is from 10 to 90 %, overshoot the highest pressure above PIP, plateau the error \
             over the last 0.3 s, valve effort how much the command changes per second on the plateau. \
             Both controllers met the same sensor noise ({seeds} seeds, none of them used for tuning or training). On its learned simulator the controller scored {:.3} cmH2O.",
            self.summary.mean.learned_on_simulator
        );
        Section::new("Result", text, vec![Block::Table(self.summary.table()), Block::Table(rivals)])
    }

    /// One inspiration under the best PID and the learned controller, as an SVG document.
    ///
    /// # Errors
    /// A pressure that is not finite.
    pub fn picture(&self) -> Result<String, ReportError> {
        self.pressure("One inspiration", 1, INSPIRATION_SHOWN).to_svg()
    }

    fn pressures(&self) -> Section {
        let breaths = self.pressure("Three breaths", 1, f64::INFINITY);
        let zooms = (0..TRACED_PIPS.len()).map(|n| self.pressure("One inspiration", n, INSPIRATION_SHOWN));
        Section::new(
            "Pressure",
            "True airway pressure against the target: three breaths, then one inspiration at three PIPs.",
            vec![Block::Plot(breaths), Block::PlotRow(zooms.collect())],
        )
    }

    /// The pressure of a traced waveform up to the time `until` in s, under the best PID and the learned controller.
    fn pressure(&self, what: &str, traced: usize, until: f64) -> Plot {
        let target = &self.contestants[3].traces[traced];
        let mut series = vec![Series::new("target", Style::Dashed, target.points(&target.target, until))];
        series.extend(self.curves(traced, until, |trace| trace.pressure.clone()));
        let title = format!("{what} at PIP {} cmH2O", TRACED_PIPS[traced]);
        Plot::over_time(title, "airway pressure, cmH2O", series)
    }

    /// The best PID's and the learned controller's values of a traced waveform.
    fn curves(&self, traced: usize, until: f64, of: fn(&BreathTrace) -> Vec<f64>) -> [Series; 2] {
        [&self.contestants[2], &self.contestants[3]].map(|contestant| {
            let trace = &contestant.traces[traced];
            Series::new(contestant.name, Style::Line, trace.points(&of(trace), until))
        })
    }

    fn valves(&self) -> Section {
        let plot =
            |title: &str, until, of| Plot::over_time(title, "command, %", self.curves(1, until, of).into());
        Section::new(
            "Valves",
            format!(
                "Commands at PIP {} cmH2O: how each controller reaches its pressure, and what the network adds to its PID.",
                TRACED_PIPS[1]
            ),
            vec![Block::PlotRow(vec![
                plot("Inspiratory valve, one inspiration", INSPIRATION_SHOWN, |trace| trace.u_in.clone()),
                self.residual(),
                plot("Expiratory valve, one breath", BREATH_SHOWN, BreathTrace::u_out_percent),
            ])],
        )
    }

    /// What the network adds to the PID underneath.
    fn residual(&self) -> Plot {
        let Contestant { name, controller, traces, .. } = &self.contestants[3];
        let residual = traces[1].points(&traces[1].residual(controller.pid()), INSPIRATION_SHOWN);
        let series = vec![Series::new(*name, Style::Line, residual)];
        Plot::over_time("Residual, one inspiration", "command, %", series)
    }

    fn simulator(&self) -> Section {
        let Some(simulator) = self.outcome.plants[0].simulators.first() else { return Section::default() };
        let all = episodes(&self.outcome.plants[0].recording, simulator.architecture.timing());
        let (_, held_out) = split(&all, self.outcome.hold_out);
        let apart = (held_out.len() / PREDICTIONS).max(1);
        let shown: Vec<&Episode> = held_out.into_iter().step_by(apart).take(PREDICTIONS).collect();
        let period = f64::from(simulator.architecture.timing().period_us) * 1e-6;
        let predictions = shown.iter().zip(predict(simulator, &shown));
        let plots = predictions.flat_map(|(episode, predicted)| {
            let title = format!("Held-out breath, PIP {:.1} cmH2O", episode.pip);
            prediction::plots(title, &episode.pressure, episode.truth.as_deref(), &predicted, period)
        });
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
/// Length of the breath shown with the expiratory valve, s.
const BREATH_SHOWN: f64 = 3.0;
