//! A small interpreter of the operators that the graphs use, so that the tests need no other runtime. Its values are matrices; true is 1,
//! false 0.

use std::collections::BTreeMap;

use crate::graph::proto::{Graph, Model, Node};

/// A matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    pub columns: usize,
    pub values: Vec<f32>,
}

impl Matrix {
    pub fn row(values: &[f32]) -> Self {
        Self { columns: values.len(), values: values.to_vec() }
    }

    fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// A value; a single row or column stands for all.
    fn at(&self, row: usize, column: usize) -> f32 {
        self.values[row.min(self.rows() - 1) * self.columns + column.min(self.columns - 1)]
    }

    fn of(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> Self {
        let value = &value;
        let values = (0..rows).flat_map(|row| (0..columns).map(move |column| value(row, column)));
        Self { columns, values: values.collect() }
    }

    fn map(&self, value: impl Fn(f32) -> f32) -> Self {
        Self { columns: self.columns, values: self.values.iter().map(|x| value(*x)).collect() }
    }
}

/// A graph with its constants.
pub struct Interpreter {
    graph: Graph,
    constants: BTreeMap<String, Matrix>,
}

impl Interpreter {
    pub fn new(model: Model) -> Self {
        let mut graph = model.graph.unwrap();
        let constant = |constant: crate::graph::proto::Tensor| {
            let integers = constant.int64_data.iter().map(|value| *value as f32);
            let values: Vec<f32> = constant.float_data.iter().copied().chain(integers).collect();
            (constant.name, Matrix { columns: *constant.dims.last().unwrap() as usize, values })
        };
        let constants = std::mem::take(&mut graph.initializer).into_iter().map(constant).collect();
        Self { graph, constants }
    }

    /// The graph with its `n`-th largest constant 1 % larger.
    pub fn with_changed_constant(&self, n: usize) -> Self {
        let mut changed = Self { graph: self.graph.clone(), constants: self.constants.clone() };
        let mut by_size: Vec<_> =
            changed.constants.values_mut().map(|constant| &mut constant.values).collect();
        by_size.sort_by_key(|values| std::cmp::Reverse(values.len()));
        by_size[n].iter_mut().for_each(|weight| *weight *= 1.01);
        changed
    }

    /// Number of columns of an input.
    pub fn columns(&self, name: &str) -> usize {
        let input = self.graph.input.iter().find(|input| input.name == name).unwrap();
        let dim = input.kind.clone().unwrap().tensor.unwrap().shape.unwrap().dim;
        match dim[1].size {
            Some(crate::graph::proto::Size::Value(columns)) => columns as usize,
            _ => panic!("{name} has no fixed number of columns"),
        }
    }

    /// Computes all values of the graph.
    pub fn run(&self, inputs: &[(&str, Matrix)]) -> BTreeMap<String, Matrix> {
        let mut values = self.constants.clone();
        values.extend(inputs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
        for node in &self.graph.node {
            let inputs: Vec<&Matrix> = node.input.iter().map(|name| &values[name]).collect();
            let outputs = compute(node, &inputs);
            values.extend(node.output.iter().cloned().zip(outputs));
        }
        values
    }
}

fn attribute(node: &Node, name: &str) -> Option<i64> {
    node.attribute.iter().find(|attribute| attribute.name == name).map(|attribute| attribute.i)
}

fn compute(node: &Node, x: &[&Matrix]) -> Vec<Matrix> {
    let rows = x.iter().map(|x| x.rows()).max().unwrap();
    let wide = x.iter().map(|x| x.columns).max().unwrap();
    let truth = |holds: bool| f32::from(u8::from(holds));
    let each = |value: &dyn Fn(f32) -> f32| x[0].map(value);
    let both = |value: &dyn Fn(f32, f32) -> f32| {
        Matrix::of(rows, wide, |row, column| value(x[0].at(row, column), x[1].at(row, column)))
    };
    vec![match node.op_type.as_str() {
        "Identity" | "Cast" => x[0].clone(),
        "Not" => each(&|x| 1.0 - x),
        "Abs" => each(&f32::abs),
        "Floor" => each(&f32::floor),
        "Round" => each(&f32::round_ties_even),
        "Sqrt" => each(&f32::sqrt),
        "Exp" => each(&f32::exp),
        "Log" => each(&f32::ln),
        "Reciprocal" => each(&|x| 1.0 / x),
        "Tanh" => each(&f32::tanh),
        "Relu" => each(&|x| x.max(0.0)),
        "Sigmoid" => each(&|x| 1.0 / (1.0 + (-x).exp())),
        "Softsign" => each(&|x| x / (1.0 + x.abs())),
        "Selu" => each(&|x| 1.050_701 * if x > 0.0 { x } else { 1.673_263_2 * x.exp_m1() }),
        "Add" => both(&|a, b| a + b),
        "Sub" => both(&|a, b| a - b),
        "Mul" | "And" => both(&|a, b| a * b),
        "Div" => both(&|a, b| a / b),
        "Pow" => both(&f32::powf),
        "Max" | "Or" => both(&f32::max),
        "Min" => both(&f32::min),
        "Less" => both(&|a, b| truth(a < b)),
        "LessOrEqual" => both(&|a, b| truth(a <= b)),
        "Greater" => both(&|a, b| truth(a > b)),
        "GreaterOrEqual" => both(&|a, b| truth(a >= b)),
        "Equal" => both(&|a, b| truth((a - b).abs() < 0.5)),
        "Where" => Matrix::of(rows, wide, |row, column| {
            if x[0].at(row, column) > 0.5 { x[1].at(row, column) } else { x[2].at(row, column) }
        }),
        "Sum" => Matrix::of(rows, wide, |row, column| x.iter().map(|x| x.at(row, column)).sum()),
        "ReduceSum" => Matrix::of(rows, 1, |row, _| (0..x[0].columns).map(|n| x[0].at(row, n)).sum()),
        "Gather" => Matrix::of(x[0].rows(), x[1].columns, |row, n| x[0].at(row, x[1].at(0, n) as usize)),
        "GatherElements" => Matrix::of(rows, x[1].columns, |row, n| x[0].at(row, x[1].at(row, n) as usize)),
        "Gemm" => {
            assert_eq!(attribute(node, "transB"), Some(1));
            let sum = |row, n| {
                (0..x[0].columns).fold(x[2].at(0, n), |sum, k| sum + x[1].at(n, k) * x[0].at(row, k))
            };
            Matrix::of(x[0].rows(), x[1].rows(), sum)
        }
        "Concat" => {
            let part = |row: usize| x.iter().flat_map(move |x| (0..x.columns).map(move |n| x.at(row, n)));
            let columns = x.iter().map(|x| x.columns).sum();
            Matrix { columns, values: (0..rows).flat_map(part).collect() }
        }
        "Split" => return split(x[0], x[1]),
        other => panic!("the interpreter does not know {other}"),
    }]
}

fn split(whole: &Matrix, widths: &Matrix) -> Vec<Matrix> {
    let mut from = 0;
    let mut piece = |width: &f32| {
        let (first, width) = (from, *width as usize);
        from += width;
        Matrix::of(whole.rows(), width, |row, n| whole.at(row, first + n))
    };
    widths.values.iter().map(&mut piece).collect()
}
