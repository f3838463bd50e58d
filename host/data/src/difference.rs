//! The first difference between two values, in words.

use serde::Serialize;
use serde_json::Value;

/// Longest text of a value that is quoted.
const QUOTED: usize = 60;

/// The first difference between two values as JSON, such as "`seed` is 5 there and 6 here"; none if they are equal.
pub fn between<T: Serialize, U: Serialize>(there: &T, here: &U) -> Option<String> {
    find("", &json(there), &json(here))
}

/// A value as it is read back from a file. Its text is parsed, because a file says 0.1 for a number of single precision, which is
/// another number in double precision.
fn json<T: Serialize>(value: &T) -> Value {
    let text = serde_json::to_string(value).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

fn find(name: &str, there: &Value, here: &Value) -> Option<String> {
    match (there, here) {
        (Value::Object(one), Value::Object(other)) => {
            let names = one.keys().chain(other.keys().filter(|name| !one.contains_key(*name)));
            let value =
                |map: &serde_json::Map<String, Value>, key| map.get(key).cloned().unwrap_or(Value::Null);
            names.into_iter().find_map(|key| find(key, &value(one, key), &value(other, key)))
        }
        (Value::Array(one), Value::Array(other)) if one.len() == other.len() => {
            one.iter().zip(other).find_map(|(one, other)| find(name, one, other))
        }
        _ if there == here => None,
        (Value::String(one), Value::String(other)) => {
            // Of texts of several lines, such as a bench's description, the first line that differs.
            let lines = one.lines().zip(other.lines()).find(|(one, other)| one != other);
            let (one, other) = lines.unwrap_or((one, other));
            Some(told(name, &one.into(), &other.into()))
        }
        _ => Some(told(name, there, here)),
    }
}

fn told(name: &str, there: &Value, here: &Value) -> String {
    format!("`{name}` is {} there and {} here", quoted(there), quoted(here))
}

fn quoted(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= QUOTED {
        text
    } else {
        text.chars().take(QUOTED).chain("...".chars()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_innermost_difference_is_named() {
        let of = |there, here| between::<Value, Value>(&there, &here);
        assert_eq!(of(json!({"seed": 1}), json!({"seed": 1})), None);
        let found = of(json!({"a": 1, "pid": {"p": 2, "i": 3}}), json!({"a": 1, "pid": {"p": 2, "i": 4}}));
        assert_eq!(found.unwrap(), "`i` is 3 there and 4 here");
        assert_eq!(of(json!({}), json!({"b": 1})).unwrap(), "`b` is null there and 1 here");
        assert_eq!(of(json!({"c": [1, 2]}), json!({"c": [1]})).unwrap(), "`c` is [1,2] there and [1] here");
        let long = of(json!({"d": "x".repeat(100)}), json!({"d": ""})).unwrap();
        assert!(long.len() < 100, "{long}");
        let lines = of(json!({"e": "a\nb = 1\nc"}), json!({"e": "a\nb = 2\nc"}));
        assert_eq!(lines.unwrap(), "`e` is \"b = 1\" there and \"b = 2\" here");
        assert_eq!(
            of(json!({"f": "a"}), json!({"f": "a\nb"})).unwrap(),
            "`f` is \"a\" there and \"a\\nb\" here"
        );
        assert_eq!(between(&json!([0.1]), &[0.1_f32]), None, "read from a file, and not yet written");
    }
}
