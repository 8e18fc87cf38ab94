"""Reads {"schema": .., "instances": [..]} from standard input and prints a list: for each instance what the schema holds against it."""

import json
import sys

import jsonschema_rs

given = json.load(sys.stdin)
jsonschema_rs.meta.validate(given["schema"])
validator = jsonschema_rs.Draft202012Validator(given["schema"])
json.dump([[error.message for error in validator.iter_errors(instance)] for instance in given["instances"]], sys.stdout)
