"""Random problems, each judged by references and by relations that every right filter keeps."""
