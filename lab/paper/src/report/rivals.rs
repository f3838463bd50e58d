//! The section on controllers for a whole family of plants.

use super::super::rivals::{Contender, Contest};
use super::super::study::Study;
use super::super::{LungMeans, Results};
use score::evaluate::Score;
use show::report::{Block, Cell, Section, Table};

pub(super) fn rivals_section(study: &Study<'_>, results: &Results) -> Section {
    let (lungs, unseen) = results.rivals.split_at(study.lungs().len());
    let learning = study.reproduction.budget.breaths_of_learning;
    Section::new(
        "Controllers for a family of plants",
        format!(
            "These controllers were tuned or trained for the family `adult` of machines and lungs, not for these \
             plants. But the paper's lungs run on the nominal machine, on which `adult` was trained among others and \
             whose valve `feed-forward` knows exactly. Three are laws from the literature: a PID with a higher gain on \
             large errors, iterative learning over a PID, and a PID with the inverse of a model that is partly \
             identified from the breaths. `adult` is the shipped learned controller, `gated` the same with iterative \
             learning over it. Some learn from breath to breath, so the first breath from rest is scored and then \
             those after {learning} breaths of learning, under one sequence of noise. The valve effort is the total \
             variation and the standard deviation of the command over the plateau. The cough comes in the second \
             breath, before the scored later ones. Bold marks the lowest error of a row."
        ),
        vec![
            Block::Table(means(lungs, results.mean.as_ref(), learning)),
            Block::Table(by_plant("Mean error on the lungs after learning, cmH2O", lungs)),
            Block::Table(by_plant("Mean error on the unseen plants after learning, cmH2O", unseen)),
        ],
    )
}

/// Means over the lungs of each controller.
fn means(lungs: &[Contest], means: Option<&LungMeans>, learning: usize) -> Table {
    let bound = means.and_then(|means| means.bound);
    let later = format!("after {learning}");
    let mut table = Table::new(
        "Means over the lungs; errors and overshoot in cmH2O",
        &[
            "controller",
            "first breath",
            &later,
            "first / bound",
            "after / bound",
            "overshoot, first",
            "overshoot, after",
            "valve, %/s",
            "valve, %",
        ],
    );
    let controllers = lungs.first().map_or(0, |contest| contest.contenders.len());
    for n in 0..controllers {
        let mean = |of: fn(&Contender) -> Score| {
            Score::mean(&lungs.iter().map(|contest| of(&contest.contenders[n])).collect::<Vec<_>>())
        };
        let (first, later) = (mean(|contender| contender.first), mean(|contender| contender.later));
        table.row(vec![
            Cell::text(&lungs[0].contenders[n].controller),
            Cell::number(first.score, 3),
            Cell::number(later.score, 3),
            Cell::known(bound.map(|bound| first.score / bound), 3),
            Cell::known(bound.map(|bound| later.score / bound), 3),
            Cell::number(first.overshoot, 2),
            Cell::number(later.overshoot, 2),
            Cell::number(later.effort.total_variation, 0),
            Cell::number(later.effort.deviation, 1),
        ]);
    }
    table
}

/// A row for each plant, a column for each controller; the best is marked.
fn by_plant(title: &str, contests: &[Contest]) -> Table {
    let names = contests.first().map_or(&[][..], |contest| &contest.contenders);
    let header: Vec<&str> =
        std::iter::once("plant").chain(names.iter().map(|contender| contender.controller.as_str())).collect();
    let mut table = Table::new(title, &header);
    for contest in contests {
        let scores = || contest.contenders.iter().map(|contender| contender.later.score);
        let best = scores().fold(f64::INFINITY, f64::min);
        let cells = scores().map(|score| Cell::number(score, 3).best_if(score <= best));
        table.row(std::iter::once(Cell::text(&contest.plant)).chain(cells).collect());
    }
    table
}
