raise ModuleNotFoundError("No module named 'rosidl_parser'", name="rosidl_parser")
