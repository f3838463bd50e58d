//! Builds the graph of an ONNX model, operator by operator.
//!
//! Every value is a matrix with a row for each member of the batch, or constants with one row, which stand for all of them. A
//! [`Value`] names such a matrix; the operators are ONNX's.

pub mod proto;
pub mod state;
pub mod symbol;

use self::proto::{
    ATTRIBUTE_INT, Attribute, Dimension, Entry, FLOAT, Graph, INT64, IR_VERSION, Model, Node, OPSET,
    OperatorSet, Shape, Size, Tensor, TensorType, Type, ValueInfo,
};
use engine::dense::DenseLayer;
use prost::Message;

/// Name of the free dimension: the size of the batch.
const BATCH: &str = "batch";

/// A value in a graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value(String);

/// A graph under construction.
#[derive(Debug)]
pub struct Builder {
    graph: Graph,
    made: usize,
}

impl Builder {
    /// An empty graph.
    pub fn new(name: &str) -> Self {
        Self { graph: Graph { name: name.to_owned(), ..Graph::default() }, made: 0 }
    }

    /// An input with this many columns.
    pub fn input(&mut self, name: &str, columns: usize, doc: &str) -> Value {
        self.graph.input.push(matrix(name, columns, doc));
        Value(name.to_owned())
    }

    /// Makes a value an output with this many columns.
    pub fn output(&mut self, name: &str, columns: usize, doc: &str, value: &Value) {
        let node = Node {
            input: vec![value.0.clone()],
            output: vec![name.to_owned()],
            name: format!("to_{name}"),
            op_type: "Identity".to_owned(),
            attribute: vec![],
        };
        self.graph.node.push(node);
        self.graph.output.push(matrix(name, columns, doc));
    }

    /// Constants of one row.
    pub fn row(&mut self, values: &[f32]) -> Value {
        self.constants(&[1, values.len()], values)
    }

    /// One constant.
    pub fn number(&mut self, value: f32) -> Value {
        self.row(&[value])
    }

    /// Constants with these dimensions, row by row.
    pub fn constants(&mut self, dims: &[usize], values: &[f32]) -> Value {
        let name = self.name("constant");
        self.graph.initializer.push(Tensor {
            dims: dims.iter().map(|size| *size as i64).collect(),
            data_type: FLOAT,
            float_data: values.to_vec(),
            int64_data: vec![],
            name: name.clone(),
        });
        Value(name)
    }

    /// A list of integers, for operators that take sizes or indices.
    fn integers(&mut self, values: &[usize]) -> Value {
        let name = self.name("integers");
        self.graph.initializer.push(Tensor {
            dims: vec![values.len() as i64],
            data_type: INT64,
            float_data: vec![],
            int64_data: values.iter().map(|value| *value as i64).collect(),
            name: name.clone(),
        });
        Value(name)
    }

    fn name(&mut self, of: &str) -> String {
        self.made += 1;
        format!("{of}_{}", self.made)
    }

    /// An operator with one output.
    pub fn op(&mut self, operator: &str, inputs: &[&Value]) -> Value {
        self.op_with(operator, inputs, &[])
    }

    /// An operator with one output and integer attributes.
    fn op_with(&mut self, operator: &str, inputs: &[&Value], attributes: &[(&str, i64)]) -> Value {
        self.ops(operator, inputs, attributes, 1).swap_remove(0)
    }

    /// An operator with any number of outputs.
    fn ops(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, i64)],
        outputs: usize,
    ) -> Vec<Value> {
        let made: Vec<String> = (0..outputs).map(|_| self.name(&operator.to_lowercase())).collect();
        let attribute =
            |(name, i): &(&str, i64)| Attribute { name: (*name).to_owned(), i: *i, kind: ATTRIBUTE_INT };
        self.graph.node.push(Node {
            input: inputs.iter().map(|value| value.0.clone()).collect(),
            output: made.clone(),
            name: format!("{operator}_{}", self.graph.node.len()),
            op_type: operator.to_owned(),
            attribute: attributes.iter().map(attribute).collect(),
        });
        made.into_iter().map(Value).collect()
    }

    /// `left + right`.
    pub fn add(&mut self, left: &Value, right: &Value) -> Value {
        self.op("Add", &[left, right])
    }

    /// `left - right`.
    pub fn sub(&mut self, left: &Value, right: &Value) -> Value {
        self.op("Sub", &[left, right])
    }

    /// `left * right`, element by element.
    pub fn mul(&mut self, left: &Value, right: &Value) -> Value {
        self.op("Mul", &[left, right])
    }

    /// `left / right`, element by element.
    pub fn div(&mut self, left: &Value, right: &Value) -> Value {
        self.op("Div", &[left, right])
    }

    /// `value * factor`.
    pub fn scale(&mut self, value: &Value, factor: f32) -> Value {
        let factor = self.number(factor);
        self.mul(value, &factor)
    }

    /// `value + amount`.
    pub fn shift(&mut self, value: &Value, amount: f32) -> Value {
        let amount = self.number(amount);
        self.add(value, &amount)
    }

    /// `from + factors (to - from)`.
    pub fn towards(&mut self, from: &Value, to: &Value, factors: &Value) -> Value {
        let difference = self.sub(to, from);
        let part = self.mul(factors, &difference);
        self.add(from, &part)
    }

    /// Limits a value to `low..=high`.
    pub fn limit(&mut self, value: &Value, low: f32, high: f32) -> Value {
        let (low, high) = (self.number(low), self.number(high));
        let above = self.op("Max", &[value, &low]);
        self.op("Min", &[&above, &high])
    }

    /// Whether `value >= number`.
    pub fn at_least(&mut self, value: &Value, number: f32) -> Value {
        let number = self.number(number);
        self.op("GreaterOrEqual", &[value, &number])
    }

    /// Whether `left < right`.
    pub fn less(&mut self, left: &Value, right: &Value) -> Value {
        self.op("Less", &[left, right])
    }

    /// Whether both hold.
    pub fn and(&mut self, left: &Value, right: &Value) -> Value {
        self.op("And", &[left, right])
    }

    /// Whether it does not hold.
    pub fn not(&mut self, value: &Value) -> Value {
        self.op("Not", &[value])
    }

    /// `yes` where the condition holds, otherwise `no`.
    pub fn choose(&mut self, condition: &Value, yes: &Value, no: &Value) -> Value {
        self.op("Where", &[condition, yes, no])
    }

    /// Zero where the condition holds, otherwise the value.
    pub fn cleared(&mut self, condition: &Value, value: &Value) -> Value {
        let zero = self.number(0.0);
        self.choose(condition, &zero, value)
    }

    /// 1 where the condition holds, otherwise 0.
    pub fn flag(&mut self, condition: &Value) -> Value {
        self.op_with("Cast", &[condition], &[("to", FLOAT.into())])
    }

    /// Divides the columns into pieces of these widths.
    pub fn split(&mut self, value: &Value, widths: &[usize]) -> Vec<Value> {
        let sizes = self.integers(widths);
        self.ops("Split", &[value, &sizes], &[("axis", 1)], widths.len())
    }

    /// Puts the columns of values beside one another.
    pub fn join(&mut self, values: &[&Value]) -> Value {
        self.op_with("Concat", values, &[("axis", 1)])
    }

    /// The columns with these numbers.
    pub fn columns(&mut self, value: &Value, columns: &[usize]) -> Value {
        let columns = self.integers(columns);
        self.op_with("Gather", &[value, &columns], &[("axis", 1)])
    }

    /// In each row the columns whose numbers are in the same row of `columns`.
    pub fn columns_by_row(&mut self, value: &Value, columns: &Value) -> Value {
        let columns = self.op_with("Cast", &[columns], &[("to", INT64.into())]);
        self.op_with("GatherElements", &[value, &columns], &[("axis", 1)])
    }

    /// Sum over the columns.
    pub fn sum(&mut self, value: &Value) -> Value {
        let axes = self.integers(&[1]);
        self.op_with("ReduceSum", &[value, &axes], &[("keepdims", 1)])
    }

    /// Sum of several values, in their order.
    pub fn sum_of(&mut self, values: &[&Value]) -> Value {
        self.op("Sum", values)
    }

    /// Puts a new first column before the others, of which the last one is dropped; `width` is the number of columns.
    pub fn pushed(&mut self, newest: &Value, history: &Value, width: usize) -> Value {
        let kept: Vec<usize> = (0..width - 1).collect();
        let kept = self.columns(history, &kept);
        self.join(&[newest, &kept])
    }

    /// A fully connected layer: `weights` has a row for each output.
    pub fn dense(&mut self, value: &Value, weights: &[f32], bias: &[f32]) -> Value {
        let (outputs, inputs) = (bias.len(), weights.len() / bias.len().max(1));
        let (weights, bias) = (self.constants(&[outputs, inputs], weights), self.row(bias));
        self.op_with("Gemm", &[value, &weights, &bias], &[("transB", 1)])
    }

    /// A fully connected layer of a parameter vector.
    pub fn layer(&mut self, value: &Value, layer: &DenseLayer, parameters: &[f32]) -> Value {
        let (weights, bias) = layer.slice(parameters).split_at(layer.inputs * layer.outputs);
        self.dense(value, weights, bias)
    }

    /// The file's bytes.
    pub fn encode(self, doc: &str, metadata: &[(&str, String)]) -> Vec<u8> {
        let entry = |(key, value): &(&str, String)| Entry { key: (*key).to_owned(), value: value.clone() };
        let model = Model {
            ir_version: IR_VERSION,
            producer_name: "eupnea".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            doc_string: doc.to_owned(),
            graph: Some(self.graph),
            opset_import: vec![OperatorSet { domain: String::new(), version: OPSET }],
            metadata_props: metadata.iter().map(entry).collect(),
        };
        model.encode_to_vec()
    }
}

/// A matrix of floats with a free number of rows.
fn matrix(name: &str, columns: usize, doc: &str) -> ValueInfo {
    let sizes = [Size::Name(BATCH.to_owned()), Size::Value(columns as i64)];
    let dim = sizes.map(|size| Dimension { size: Some(size) }).to_vec();
    let tensor = TensorType { elem_type: FLOAT, shape: Some(Shape { dim }) };
    ValueInfo { name: name.to_owned(), kind: Some(Type { tensor: Some(tensor) }), doc_string: doc.to_owned() }
}
