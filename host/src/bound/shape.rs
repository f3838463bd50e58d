//! A command sequence by its nodes: few numbers where the command hardly bends, one per tick where it does.

/// Commands in percent at nodes, with straight lines between them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    /// Ticks of the nodes, rising; the first is 0, the last that of the inspiration's end.
    pub(super) nodes: Vec<usize>,
    /// Command at each node, percent.
    pub(super) values: Vec<f64>,
}

impl Shape {
    /// The shape with nodes every `spacing` ticks that goes through `commands` there.
    pub(super) fn through(commands: &[f32], spacing: usize) -> Self {
        let last = commands.len().saturating_sub(1);
        let mut nodes: Vec<usize> = (0..last).step_by(spacing.max(1)).collect();
        nodes.push(last);
        let values = nodes.iter().map(|node| f64::from(commands[*node])).collect();
        Self { nodes, values }
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

    /// Ticks that a node moves, and how far per percent of its own movement.
    pub(super) fn reach(&self, node: usize) -> impl Iterator<Item = (usize, f64)> {
        let here = self.nodes[node];
        let before = node.checked_sub(1).map_or(here, |n| self.nodes[n]);
        let after = self.nodes.get(node + 1).copied().unwrap_or(here);
        let first = if before < here { before + 1 } else { here };
        (first..after.max(here + 1)).map(move |tick| {
            let share = if tick < here {
                (tick - before) as f64 / (here - before) as f64
            } else if tick > here {
                (after - tick) as f64 / (after - here) as f64
            } else {
                1.0
            };
            (tick, share)
        })
    }

    /// The same sequence with further nodes wherever it bends by more than `bend` percent at an end of an interval.
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

    /// How far a node lies from the line between its neighbours, percent.
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
