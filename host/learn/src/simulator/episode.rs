//! Episodes: the inspirations of a recording, cut into a simulator's blocks.

use std::collections::BTreeMap;
use std::ops::Range;

use super::{COMMAND_SCALE, Timing};
use data::identity::{LungParameters, TestRun};
use data::recording::Recording;
use engine::least_squares::solve;

/// Time before the inspiration over which its starting pressure is averaged, and time before the end of the last
/// inspiration over which its plateau is averaged, s.
const AVERAGE_TIME: f32 = 0.05;

/// One inspiration.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// Measured pressure at each control tick, cmH2O.
    pub pressure: Vec<f32>,
    /// True airway pressure at each control tick, if the recording contains it, cmH2O.
    pub truth: Option<Vec<f32>>,
    /// Scaled commands: mean of each part of each block; all channels of a part are adjacent.
    pub commands: Vec<f32>,
    /// Scaled commands before the inspiration, per place of a block.
    pub rest: Vec<f32>,
    /// Pressure before the inspiration, cmH2O.
    pub start: f32,
    /// Pressure at the end of the previous inspiration, cmH2O.
    pub plateau: f32,
    /// Inspiratory and expiratory time of the breath before, s; of the first one of a run, those of the episode's own breath.
    pub phases: [f32; 2],
    /// Scaled command of the inspiratory valve at the end of the previous inspiration.
    pub plateau_command: f32,
    /// PIP of the breath, cmH2O.
    pub pip: f32,
    /// PEEP of the expiration before, cmH2O: what the lung emptied to.
    pub peep: f32,
    /// Group of the breath in its recording (a lung, a test run), if it has groups.
    pub group: Option<u32>,
    /// Ventilator of the group, if it has groups: see [`ventilators`].
    pub ventilator: Option<u32>,
    /// Rows of the episode in the recording.
    pub rows: Range<usize>,
    /// The lung, if the recording names it.
    pub lung: Option<LungParameters>,
}

impl Episode {
    /// Number of control ticks.
    pub fn ticks(&self) -> usize {
        self.pressure.len()
    }

    /// Leaves out what comes after this many ticks.
    pub fn cut(&mut self, ticks: usize) {
        let kept = ticks.min(self.ticks());
        self.pressure.truncate(kept);
        self.truth.iter_mut().for_each(|truth| truth.truncate(kept));
        self.rows.end = self.rows.end.min(self.rows.start + kept);
    }
}

/// The complete inspirations of a recording, in its order.
pub fn episodes(recording: &Recording, timing: &Timing) -> Vec<Episode> {
    cut(recording, timing, |inspiration| inspiration)
}

/// The complete breaths of a recording, including expirations, which also contain information about the plant.
pub fn whole_breaths(recording: &Recording, timing: &Timing) -> Vec<Episode> {
    cut(recording, timing, |inspiration| {
        let rest = &recording.breath[inspiration.start..];
        let length = rest.iter().take_while(|breath| **breath == rest[0]).count();
        // Replay ends at a missing tick.
        let ticks = &recording.tick[inspiration.start..inspiration.start + length];
        let whole = ticks.iter().enumerate().take_while(|(n, tick)| *n == **tick as usize).count();
        inspiration.start..inspiration.start + whole
    })
}

fn cut(
    recording: &Recording,
    timing: &Timing,
    extent: impl Fn(Range<usize>) -> Range<usize>,
) -> Vec<Episode> {
    let average = (shared::math::ticks(AVERAGE_TIME, timing.period_us) as usize).max(1);
    let (ventilators, period_s) = (ventilators(recording), 1e-6 * timing.period_us as f32);
    let (mut last_plateau, mut last_command, mut last_rows) = (None, None, None);
    let mut episodes = Vec::new();
    for rows in recording.inspirations() {
        let group = recording.group.as_ref().map(|group| group[rows.start]);
        let same_run = rows.start > 0
            && recording.group.as_ref().is_none_or(|group| group[rows.start - 1] == group[rows.start]);
        let before = if same_run {
            rows.start.saturating_sub(average)..rows.start
        } else {
            rows.start..rows.start + 1
        };
        let plateau = last_plateau.filter(|_| same_run).unwrap_or(recording.peep[rows.start]);
        let rest = if same_run { rows.start - 1 } else { rows.start };
        let extent = extent(rows.clone());
        let last_rows: Option<Range<usize>> = last_rows.replace(rows.clone()).filter(|_| same_run);
        episodes.push(Episode {
            pressure: recording.pressure[extent.clone()].to_vec(),
            truth: recording.pressure_true.as_ref().map(|truth| truth[extent.clone()].to_vec()),
            commands: commands(recording, &extent, timing),
            rest: (0..timing.width())
                .map(|place| channel(recording, rest, place % timing.channels))
                .collect(),
            start: mean(&recording.pressure[before]),
            plateau,
            phases: phases(recording, &rows, last_rows).map(|ticks| ticks as f32 * period_s),
            plateau_command: last_command.filter(|_| same_run).unwrap_or(channel(recording, rest, 0)),
            pip: recording.pip[rows.start],
            peep: recording.peep[if same_run { rows.start - 1 } else { rows.start }],
            group,
            ventilator: group.and_then(|group| ventilators.get(group as usize).copied()),
            rows: rows.clone(),
            lung: recording.lung(rows.start),
        });
        let end = rows.end - average.min(rows.len())..rows.end;
        last_plateau = Some(mean(&recording.pressure[end.clone()]));
        last_command = Some(mean(&recording.u_in[end]) / COMMAND_SCALE);
    }
    episodes
}

/// Index of the ventilator of each group.
pub fn ventilators(recording: &Recording) -> Vec<u32> {
    let mut known = Vec::new();
    let mut index = |run: &TestRun| {
        known.iter().position(|ventilator| *ventilator == run.ventilator).unwrap_or_else(|| {
            known.push(run.ventilator.clone());
            known.len() - 1
        }) as u32
    };
    recording.provenance.groups.iter().map(&mut index).collect()
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len().max(1) as f32
}

/// Largest distance of a valve's command from a linear function of another's at which it is redundant, percent. The
/// `RespiraWorks` ventilator's commands are 1.9 apart where one of them is at an end of its range.
const FOLLOWS: f64 = 2.5;

/// Number of relevant command channels in a recording: the inspiratory valve; also the expiratory valve, unless during
/// inspirations its command is a linear function of the inspiratory one, which no fit could separate; also the oxygen
/// valve, if it moves at all.
pub fn channels(recording: &Recording) -> usize {
    let moves = |values: &[f32]| values.windows(2).any(|pair| pair[0].total_cmp(&pair[1]).is_ne());
    if recording.u_psol.as_deref().is_some_and(moves) {
        3
    } else if recording.inspirations().into_iter().any(|rows| moves(&recording.u_out[rows]))
        && !follows(recording)
    {
        2
    } else {
        1
    }
}

/// Whether the expiratory valve's commands in inspirations are a linear function of the inspiratory valve's.
fn follows(recording: &Recording) -> bool {
    let rows: Vec<usize> = recording.inspirations().into_iter().flatten().collect();
    let columns: Vec<_> = rows.iter().map(|row| [1.0, f64::from(recording.u_in[*row])]).collect();
    let values: Vec<_> = rows.iter().map(|row| f64::from(recording.u_out[*row])).collect();
    solve(&columns, &values).is_some_and(|line| {
        let [level, slope] = line.coefficients;
        columns.iter().zip(&values).all(|(row, value)| (value - level - slope * row[1]).abs() < FOLLOWS)
    })
}

/// Inspiration and expiration of the breath before an inspiration; if that is not known, of its own breath; ticks.
fn phases(recording: &Recording, rows: &Range<usize>, before: Option<Range<usize>>) -> [usize; 2] {
    let (inspiration, next) = before.map_or_else(
        || {
            let own = &recording.breath[rows.start..];
            (rows.clone(), rows.start + own.iter().take_while(|breath| **breath == own[0]).count())
        },
        |before| (before, rows.start),
    );
    [inspiration.len(), next - inspiration.end]
}

/// Scaled command of a channel: 0 is the inspiratory valve, 1 the expiratory one, 2 the oxygen valve.
fn channel(recording: &Recording, row: usize, channel: usize) -> f32 {
    let percent = match channel {
        0 => recording.u_in[row],
        1 => recording.u_out[row],
        _ => recording.u_psol.as_ref().map_or(0.0, |u| u[row]),
    };
    percent / COMMAND_SCALE
}

/// Means over the parts of all blocks; the last block may be short.
fn commands(recording: &Recording, rows: &Range<usize>, timing: &Timing) -> Vec<f32> {
    let blocks = timing.blocks(rows.len());
    let width = timing.width();
    let (mut sums, mut counts) = (vec![0.0; blocks * width], vec![0.0_f32; blocks * width]);
    for tick in 0..rows.len() {
        let part = timing.part(tick % timing.block_ticks);
        for c in 0..timing.channels {
            let place = tick / timing.block_ticks * width + part * timing.channels + c;
            sums[place] += channel(recording, rows.start + tick, c);
            counts[place] += 1.0;
        }
    }
    sums.iter().zip(&counts).map(|(sum, count)| sum / count.max(1.0)).collect()
}

/// Splits episodes into training episodes and held-out ones, which are every `every`-th of each group.
pub fn split(episodes: &[Episode], every: usize) -> (Vec<&Episode>, Vec<&Episode>) {
    let mut before: BTreeMap<Option<u32>, usize> = BTreeMap::new();
    episodes.iter().partition(|episode| {
        let place = before.entry(episode.group).or_default();
        *place += 1;
        !place.is_multiple_of(every.max(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use data::provenance::Provenance;
    use data::recording::Row;

    /// Two breaths with 25 ms of inspiration and 10 ms of rest; the command equals ten times the tick.
    fn recording() -> Recording {
        let mut recording = Recording::new(Provenance::new(1000, "test"), true);
        for (breath, tick) in (0..2).flat_map(|breath| (0..35).map(move |tick| (breath, tick))) {
            let inspiration = tick < 25;
            recording.push(Row {
                breath,
                tick,
                phase: if inspiration { 0 } else { 2 },
                pressure: if inspiration { 20.0 + breath as f32 } else { 5.0 },
                u_in: if inspiration { tick as f32 } else { 5.0 },
                pip: 20.0,
                peep: 4.0,
                pressure_true: Some(7.0),
                pressure_sensor_true: Some(7.0),
                ..Row::default()
            });
        }
        recording
    }

    #[test]
    fn commands_are_means_over_parts() {
        let episodes = episodes(&recording(), &Timing::for_period(1000, 1));
        assert_eq!(episodes.len(), 2);
        let percent: Vec<f32> = episodes[0].commands.iter().map(|c| c * COMMAND_SCALE).collect();
        let expected = [2.0, 7.0, 12.0, 17.0, 22.0, 0.0];
        assert!(percent.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{percent:?}");
    }

    #[test]
    fn whole_breaths_go_on_after_the_inspiration_until_a_tick_is_lost() {
        let timing = Timing::for_period(1000, 1);
        let mut recording = recording();
        let (short, whole) = (episodes(&recording, &timing), whole_breaths(&recording, &timing));
        assert_eq!((short[1].ticks(), whole[1].ticks(), whole[1].commands.len()), (25, 35, 8));
        assert_eq!((&short[1].rows, short[1].plateau), (&whole[1].rows, whole[1].plateau));
        recording.tick[65..].iter_mut().for_each(|tick| *tick += 1);
        assert_eq!(whole_breaths(&recording, &timing)[1].ticks(), 30);
    }

    #[test]
    fn a_breath_starts_where_the_last_one_ended() {
        let episodes = episodes(&recording(), &Timing::for_period(1000, 1));
        let (first, second) = (&episodes[0], &episodes[1]);
        assert!((first.start - 20.0).abs() < 1e-6 && (first.plateau - 4.0).abs() < 1e-6);
        assert!((second.start - (20.0 * 25.0 + 5.0 * 10.0) / 35.0).abs() < 1e-4, "mean of what there is");
        assert!((second.plateau - 20.0).abs() < 1e-6);
        assert!((second.rest[0] * COMMAND_SCALE - 5.0).abs() < 1e-6);
    }

    #[test]
    fn a_breath_after_a_change_of_peep_starts_at_the_old_one() {
        let mut recording = recording();
        recording.peep[35..].fill(12.0);
        let peeps: Vec<f32> =
            episodes(&recording, &Timing::for_period(1000, 1)).iter().map(|e| e.peep).collect();
        assert_eq!(peeps, [4.0, 4.0]);
    }

    #[test]
    fn a_breath_knows_the_phases_of_the_one_before() {
        let mut recording = recording();
        recording.phase[20..25].fill(2);
        let phases = |n: usize| {
            episodes(&recording, &Timing::for_period(1000, 1))[n].phases.map(|s| (1e3 * s).round())
        };
        assert_eq!((phases(0), phases(1)), ([20.0, 15.0], [20.0, 15.0]));
    }

    #[test]
    fn only_valves_that_move_are_channels() {
        let mut recording = recording();
        recording.u_out.iter_mut().zip(&recording.phase).for_each(|(u, phase)| *u = 50.0 * f32::from(*phase));
        assert_eq!(channels(&recording), 1, "open or shut as the phase has it");
        recording.u_psol = Some(vec![0.0; recording.len()]);
        recording.u_out[3] = 50.0;
        assert_eq!(channels(&recording), 2);
        recording.u_psol = Some((0..recording.len()).map(|row| row as f32).collect());
        assert_eq!(channels(&recording), 3);
    }

    #[test]
    fn a_valve_that_follows_another_is_no_channel() {
        let mut recording = recording();
        recording.u_out = recording.u_in.iter().map(|u| 60.0 - 0.5 * u + 0.01 * u * u).collect();
        assert_eq!(channels(&recording), 1, "two percent from a line");
        recording.u_out[7] += 5.0;
        assert_eq!(channels(&recording), 2);
    }
}
