//! A command sequence by its nodes: few where the command hardly bends, up to one per tick where it does.

/// Commands in percent at nodes, linear between them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CommandShape {
    /// Ticks of the nodes, ascending; the first is 0, the last the end of the inspiration.
    pub(super) nodes: Vec<usize>,
    /// Command at each node, percent.
    pub(super) values: Vec<f64>,
}

impl CommandShape {
    /// The shape with nodes every `spacing` ticks that passes through `commands` there.
    pub(super) fn through(commands: &[f32], spacing: usize) -> Self {
        let last = commands.len().saturating_sub(1);
        let mut nodes: Vec<usize> = (0..last).step_by(spacing.max(1)).collect();
        nodes.push(last);
        let values = nodes.iter().map(|node| f64::from(commands[*node])).collect();
        Self { nodes, values }
    }

    /// The shape with only every `keep`-th of the nodes after the tick `from`, and the last one.
    pub(super) fn thinned(&self, from: usize, keep: usize) -> Self {
        let last = self.nodes.len().saturating_sub(1);
        let dense = self.nodes.partition_point(|node| *node <= from);
        let stays = |place: usize| place < dense || place == last || (place + 1 - dense).is_multiple_of(keep);
        let places: Vec<usize> = (0..=last).filter(|place| stays(*place)).collect();
        Self {
            nodes: places.iter().map(|place| self.nodes[*place]).collect(),
            values: places.iter().map(|place| self.values[*place]).collect(),
        }
    }

    /// The command of every tick.
    pub(super) fn commands(&self) -> Vec<f32> {
        let mut commands = Vec::with_capacity(self.nodes.last().map_or(0, |last| last + 1));
        for (nodes, values) in self.nodes.windows(2).zip(self.values.windows(2)) {
            let width = (nodes[1] - nodes[0]) as f64;
            commands.extend((nodes[0]..nodes[1]).map(|tick| {
                let share = (tick - nodes[0]) as f64 / width;
                (values[0] + (values[1] - values[0]) * share) as f32
            }));
        }
        commands.extend(self.values.last().map(|value| *value as f32));
        commands
    }

    /// The ticks that a node affects, and their change per percent of the node's movement.
    pub(super) fn reach(&self, node: usize) -> impl Iterator<Item = (usize, f64)> {
        let here = self.nodes[node];
        let before = node.checked_sub(1).map(|n| self.nodes[n]);
        let after = self.nodes.get(node + 1).copied().unwrap_or(here + 1);
        let part = |of: usize, width: usize| of as f64 / width as f64;
        let rising = before.into_iter().flat_map(move |before| {
            (before + 1..here).map(move |tick| (tick, part(tick - before, here - before)))
        });
        rising.chain((here..after).map(move |tick| (tick, part(after - tick, after - here))))
    }

    /// The same sequence with more nodes wherever it bends by more than `bend` percent at an end of an interval.
    pub(super) fn refined(&self, bend: f64) -> Self {
        let bends: Vec<bool> = (0..self.nodes.len()).map(|node| self.bend(node) > bend).collect();
        let mut refined = Self { nodes: Vec::new(), values: Vec::new() };
        for node in 0..self.nodes.len() {
            refined.push(self.nodes[node], self.values[node]);
            let Some(next) = self.nodes.get(node + 1) else { break };
            let middle = usize::midpoint(self.nodes[node], *next);
            if middle > self.nodes[node] && (bends[node] || bends[node + 1]) {
                let share = (middle - self.nodes[node]) as f64 / (next - self.nodes[node]) as f64;
                refined.push(middle, self.values[node] + share * (self.values[node + 1] - self.values[node]));
            }
        }
        refined
    }

    fn push(&mut self, node: usize, value: f64) {
        self.nodes.push(node);
        self.values.push(value);
    }

    /// Distance of a node from the line between its neighbours, percent.
    fn bend(&self, node: usize) -> f64 {
        if node == 0 || node + 1 == self.nodes.len() {
            return 0.0;
        }
        let (left, here, right) = (self.nodes[node - 1], self.nodes[node], self.nodes[node + 1]);
        let share = (here - left) as f64 / (right - left) as f64;
        let line = self.values[node - 1] + share * (self.values[node + 1] - self.values[node - 1]);
        (self.values[node] - line).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shape() -> impl Strategy<Value = CommandShape> {
        (prop::collection::vec(0.0f32..100.0, 2..200), 1usize..30)
            .prop_map(|(commands, spacing)| CommandShape::through(&commands, spacing))
    }

    proptest! {
        #[test]
        fn a_node_in_every_tick_keeps_every_command(commands in prop::collection::vec(0.0f32..100.0, 1..100)) {
            prop_assert_eq!(CommandShape::through(&commands, 1).commands(), commands);
        }

        #[test]
        fn more_nodes_are_the_same_sequence(shape in shape()) {
            let refined = shape.refined(0.5);
            prop_assert!(refined.nodes.windows(2).all(|pair| pair[0] < pair[1]));
            for (one, other) in shape.commands().iter().zip(refined.commands()) {
                prop_assert!((one - other).abs() < 1e-3, "{} {}", one, other);
            }
        }

        #[test]
        fn a_node_moves_the_ticks_in_its_reach_and_no_others(shape in shape(), node in any::<prop::sample::Index>()) {
            let node = node.index(shape.nodes.len());
            let mut moved = shape.clone();
            moved.values[node] += 1.0;
            let mut expected = shape.commands();
            for (tick, share) in shape.reach(node) {
                expected[tick] += share as f32;
            }
            for (one, other) in moved.commands().iter().zip(expected) {
                prop_assert!((one - other).abs() < 1e-3, "{} {}", one, other);
            }
        }
    }

    #[test]
    fn nodes_of_a_long_inspiration_are_thinned_and_those_of_a_short_one_stay() {
        let shape = |ticks: usize| CommandShape::through(&vec![20.0; ticks], 8);
        assert_eq!(shape(1000).thinned(1000, 4), shape(1000));
        let thinned = shape(1100).thinned(1000, 4);
        assert_eq!(thinned.nodes[..126], shape(1100).nodes[..126]);
        assert_eq!(thinned.nodes[126..], [1032, 1064, 1096, 1099]);
    }

    #[test]
    fn nodes_are_added_where_the_command_bends() {
        let commands: Vec<f32> = (0..65).map(|tick| if tick < 32 { 80.0 } else { 10.0 }).collect();
        let refined = CommandShape::through(&commands, 8).refined(0.5);
        assert_eq!(refined.nodes, [0, 8, 16, 20, 24, 28, 32, 36, 40, 48, 56, 64]);
    }
}
