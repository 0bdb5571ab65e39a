"""The protocol in Promela, the language of the model checker spin. spin must find only the planted faults."""
