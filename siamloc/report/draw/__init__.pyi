from .suitable import files_of as files_of, pictures as pictures, save_all as save_all
