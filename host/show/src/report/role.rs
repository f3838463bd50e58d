//! The colours of all figures: one for each role, so that a controller looks the same in every figure, and on the bedside page.

/// What a curve stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The pressure that a controller aims at.
    Target,
    /// The PID tuned for the plant.
    Pid,
    /// One PID for all plants.
    PidForAll,
    /// The controller learned for the plant.
    Learned,
    /// One learned controller for all plants.
    LearnedForAll,
    /// The P-only controller.
    POnly,
    /// The I-only controller.
    IOnly,
    /// A measured pressure.
    Pressure,
    /// The true pressure.
    Truth,
    /// A simulator's or a model's pressure.
    Simulator,
    /// The reference bound, or a simpler model to compare with.
    Reference,
    /// The inspiratory valve.
    InspiratoryValve,
    /// The expiratory valve.
    ExpiratoryValve,
    /// A limit, or the place of a fault.
    Limit,
    /// One of many curves behind the others.
    Background,
}

/// A colour on a light page, and the same on a dark one.
type Color = (&'static str, &'static str);

/// The roles in their order, with the names that curves have in legends.
const ROLES: [(Role, &[&str], Color); 15] = [
    (Role::Target, &["target"], ("#3F4B57", "#8FA3B8")),
    (Role::Pid, &["PID", "own best PID", "family's PID"], ("#0072B2", "#56B4E9")),
    (Role::PidForAll, &["single PID"], ("#003F66", "#A9D8F5")),
    (Role::Learned, &["learned"], ("#D55E00", "#F0A070")),
    (Role::LearnedForAll, &["learned for all", "learned, all lungs"], ("#8A3C00", "#FFC79B")),
    (Role::POnly, &["P only"], ("#B8468A", "#EBA0CC")),
    (Role::IOnly, &["I only"], ("#6E7A00", "#C9D45A")),
    (Role::Pressure, &["measured", "pressure"], ("#8F6400", "#FFD9A0")),
    (Role::Truth, &["true"], ("#1D1F21", "#EDEFF1")),
    (Role::Simulator, &["simulator", "behind the circuit"], ("#007A5E", "#4FD8B0")),
    (Role::Reference, &["reference bound", "equation of motion"], ("#6F7F90", "#6F7F90")),
    (Role::InspiratoryValve, &["inspiratory valve"], ("#6F42C1", "#D0A8FF")),
    (Role::ExpiratoryValve, &["expiratory valve"], ("#5B6B7D", "#93A5B8")),
    (Role::Limit, &["limit", "fault", "stop"], ("#C2002F", "#FF8F8F")),
    (Role::Background, &[], ("#C8C8C8", "#4A5057")),
];

/// Colours of curves without a role: Paul Tol's muted scheme, distinguishable for colour-blind readers, in two shades.
const OTHERS: [Color; 12] = [
    ("#117733", "#6CCB8B"),
    ("#AA4499", "#E08BD3"),
    ("#3A9485", "#7FD9CB"),
    ("#CC6677", "#F2A0AE"),
    ("#332288", "#A79BEA"),
    ("#85852B", "#D0D06A"),
    ("#0A471E", "#B5E5C5"),
    ("#66285B", "#EFC5E9"),
    ("#22584F", "#BFECE5"),
    ("#7A3D47", "#F8CFD6"),
    ("#8A7FD6", "#7C6ED0"),
    ("#4F4F19", "#E7E7B4"),
];

/// Background of a drawing that is no part of a page.
pub(super) const PAPER: Color = ("#FFFFFF", "#17191B");
/// Lines of a grid.
pub(super) const FAINT: Color = ("#E4E4E4", "#33383D");
/// Text and axes of a drawing that is no part of a page; in a page they have the colour of its text.
const INK: Color = ("#222222", "#E6E7E8");

impl Role {
    /// The role of a curve with this name in the legend.
    pub fn named(name: &str) -> Option<Self> {
        ROLES.iter().find(|(_, names, _)| names.contains(&name)).map(|(role, ..)| *role)
    }

    /// Its colour on a light page, and on a dark one.
    pub(super) fn color(self) -> Color {
        ROLES[self as usize].2
    }
}

/// The colour on a light page of the n-th curve without a role.
pub(super) fn other(n: usize) -> &'static str {
    OTHERS[n % OTHERS.len()].0
}

/// The rules that give a drawing the colours of a dark page. Programs that ignore them show those of a light one.
pub(super) fn dark_rules() -> String {
    let all = ROLES.iter().map(|(.., color)| color).chain(&OTHERS).chain([&PAPER, &FAINT]);
    let rule = |(light, dark): &Color| {
        format!("svg [fill=\"{light}\"]{{fill:{dark}}}svg [stroke=\"{light}\"]{{stroke:{dark}}}\n")
    };
    on_dark(&all.map(rule).collect::<String>())
}

/// The style of a drawing that is no part of a page.
pub(super) fn own_style() -> String {
    let ink = |color: &str| format!("svg{{color:{color}}}\n");
    ink(INK.0) + &on_dark(&ink(INK.1)) + &dark_rules()
}

fn on_dark(rules: &str) -> String {
    format!("@media (prefers-color-scheme: dark) {{\n{rules}}}\n")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::*;

    fn file(path: &str) -> String {
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)).unwrap()
    }

    /// Contrast ratio of two colours after WCAG 2.
    fn contrast(one: &str, other: &str) -> f64 {
        let luminance = |color: &str| -> f64 {
            let channel = |at: usize| {
                let value = f64::from(u8::from_str_radix(&color[at..at + 2], 16).unwrap()) / 255.0;
                if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
            };
            0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
        };
        let (a, b) = (luminance(one), luminance(other));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn every_colour_is_unique_and_legible_on_its_page() {
        assert!(ROLES.iter().enumerate().all(|(place, row)| row.0 as usize == place), "in their order");
        let curves: Vec<Color> = ROLES.iter().map(|row| row.2).chain(OTHERS).collect();
        for shade in [|color: &Color| color.0, |color: &Color| color.1] {
            assert_eq!(curves.iter().map(shade).collect::<BTreeSet<_>>().len(), curves.len());
        }
        for (light, dark) in curves.into_iter().filter(|color| *color != Role::Background.color()) {
            for (color, paper) in [(light, PAPER.0), (dark, PAPER.1)] {
                assert!(contrast(color, paper) >= 3.0, "{color} on {paper}: {:.2}", contrast(color, paper));
            }
        }
    }

    #[test]
    fn the_bedside_page_and_the_notebook_have_the_same_colours() {
        let css = file("host/bedside/web/src/app.css");
        for (name, role) in [
            ("target", Role::Target),
            ("pressure", Role::Pressure),
            ("learned", Role::Learned),
            ("reference", Role::Reference),
            ("valve", Role::InspiratoryValve),
            ("exhale-text", Role::ExpiratoryValve),
            ("limit", Role::Limit),
        ] {
            let line = format!("  --{name}: {};\n", role.color().1.to_lowercase());
            assert!(css.contains(&line), "app.css has no {line}");
        }
        let notebook = file("examples/notebooks/first_controller.py");
        for (name, role) in [("target", Role::Target), ("PID", Role::Pid), ("learned", Role::Learned)] {
            let entry = format!("\"{name}\": \"{}\"", role.color().0);
            assert!(notebook.contains(&entry), "the notebook has no {entry}");
        }
    }
}
